/// A spring between this hand's proxy and that of a remote hand, over a network that may delay,
/// lose, double and reorder messages.
///
/// Each end computes the spring from the last received position of the other end's proxy, and has
/// an energy tank. Work that its hand does on the spring fills the tank, and work of the spring on
/// the hand empties it. An end gives its spare energy to the other end. Each message contains the
/// sum of all energy given so far, and the receiver takes the part that it has not taken yet. So
/// the next message replaces a lost one, and a doubled or late message adds no energy.
///
/// Let w_i(t) be the work that end i has done on its hand, g_i the energy that it gave, and r_i the
/// energy that it took. Tank i holds e_i = start + r_i - g_i - w_i. As r_1 <= g_2 and r_2 <= g_1,
///
///     w_1 + w_2  =  2 start - e_1 - e_2 + (r_1 - g_2) + (r_2 - g_1)  <=  2 start - e_1 - e_2.
///
/// As long as neither tank falls below zero, the two hands together get at most 2 start, with any
/// network. The default `start` is the energy that lifts 100 g by 1 mm.
///
/// A reading is within D/2 of the hand, where D is the step of the encoders. Let F_k be the force
/// sent after reading k, and e_k the error of that reading. Summation by parts gives
///
///     sum F_k . (e_k+1 - e_k)  =  F_n . e_n+1 - sum (F_k - F_k-1) . e_k
///                             <=  D/2 (|F_n| + sum |F_k - F_k-1|) :
///
/// Each change of the force pays D/2 |F_k - F_k-1| when it is sent, and D/2 |F_n| stays reserved.
///
/// There is one assumption about the hand: until the next reading, its acceleration is at most
/// kLinkNimble. If the reading is late or the hand hits an obstacle, a force can do more work than
/// was reserved. The tank is then in debt. At each new minimum, a tank in debt halves the force
/// that it allows. The tank allows the whole force only after the debt is paid. So the sum of all
/// debts is at most twice the work of the first debt's force over the path of one tick.
#pragma once

#include <cstdint>

#include "palpate/engine/safety/device.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Parameters of the spring to a remote hand.
struct LinkParams {
  double stiffness = 200.0;  ///< k [N/m], > 0.
  double peak = 2.0;         ///< Largest pull [N], > 0.
  double start = 1e-3;       ///< Initial energy of a tank [J], >= 0.
  double step = 2e-4;        ///< D [m], >= 0: a position reading is within D/2 of the hand
                       ///< (ArmDissipation::step). The default is larger than that of desktop arms.
                       ///< A larger D makes changes of the force cost more energy.
};

/// If no message has come for this time [s], the remote hand counts as away.
inline constexpr double kLinkSilence = 0.2;
inline constexpr double kLinkRamp = 0.5;  ///< Time in which the spring fades in and out [s].
/// Time in which the allowed share of the force rises from 0 to 1 [s].
inline constexpr double kLinkRise = 0.1;
/// Upper bound of the acceleration of a hand [m/s^2], for its path until its next reading.
inline constexpr double kLinkNimble = 200.0;

/// A message from one end of the spring to the opposite end.
///
/// A life of an end begins when the end is made or forgets the other end. A later life has a
/// greater number, even after a restart of the program. Each pair of lives has its own sums of
/// energy.
struct LinkWord {
  std::uint64_t from = 0;  ///< Life of the sender; 0 without a sender.
  std::uint64_t to = 0;    ///< Life of the receiver; other lives ignore the message. 0 if unknown.
  /// Number of the message in this life. The newest message has the greatest number.
  std::uint64_t number = 0;
  Vec3 proxy = Vec3::Zero();  ///< Position of the sender's proxy [m], in the scene.
  double given = 0.0;         ///< Sum of the energy given to the receiver's life [J].
};

/// One end of the spring.
class Link {
 public:
  /// @param life  First life of this end (LinkWord): not 0, and greater than every life of the
  ///              ends that it replaces.
  explicit Link(std::uint64_t life, const LinkParams& params = {}) noexcept
      : params_(params), life_(life), energy_(params.start) {}

  /// Receives a message, which may contain any bits. Messages may come in any order, and several
  /// times. RT: no allocation.
  void hear(const LinkWord& word) noexcept PALPATE_NONBLOCKING;
  /// Forgets the other end, and accepts any life in the next message. Keeps the energy in the tank.
  void forgetOther() noexcept;

  /// Counts the work of the last force over the hand's path, and returns the next force. Between
  /// two readings of the hand the force is constant, because the work of a changing force would be
  /// unknown. Call this function once in a tick.
  ///
  /// @param proxy  This hand's proxy [m].
  /// @param hand   Reading of the hand, new or repeated, with the directions of its motors.
  /// @param part   Share of this spring if the hand has several springs, 0 to 1.
  /// @param dt     Time since the last call [s].
  /// @return       |force| <= part * peak [N], finite, along hand.drives; 0 if hand, proxy or dt is
  ///               not a usable number.
  /// RT: no allocation. Cost: O(1).
  [[nodiscard]] Vec3 pull(const Vec3& proxy, const HandState& hand, double part,
                          double dt) noexcept PALPATE_NONBLOCKING;
  /// Counts the change of the sent force. Call this function after each pull(). `share`, 0 to 1, is
  /// the share of the force that was sent; below 0 if unknown. The tank counts energy that leaves
  /// it as if the whole force was sent.
  void pulled(double share) noexcept PALPATE_NONBLOCKING;
  /// Counts the work of the last force up to now. Call this function instead of pull() if no force
  /// is sent. `hand` is the position of the hand [m].
  void rest(const Vec3& hand) noexcept PALPATE_NONBLOCKING;

  /// Returns the message for the other end. `proxy` is this end's proxy [m]. RT: no allocation.
  [[nodiscard]] LinkWord word(const Vec3& proxy) noexcept PALPATE_NONBLOCKING;

  [[nodiscard]] double energy() const noexcept { return energy_; }  ///< Energy in the tank [J].
  /// Returns the share of the spring that has faded in, 0 to 1.
  [[nodiscard]] double presence() const noexcept { return presence_; }
  /// Returns the share of the wanted force that the tank allowed in the last pull() with a force, 0
  /// to 1. The share rises at most by 1 in kLinkRise.
  [[nodiscard]] double paid() const noexcept { return paid_; }

 private:
  /// Begins a link to this life of the other end, with no energy given or taken.
  void begin(std::uint64_t other) noexcept;
  /// Counts the work of the force up to the present position `hand` [m].
  void count(const Vec3& hand) noexcept;
  /// Pays for a change of the sent force to `to` [N].
  void change(const Vec3& to) noexcept;

  LinkParams params_;
  std::uint64_t life_;
  std::uint64_t told_ = 0;  ///< Number of messages so far.

  std::uint64_t other_ = 0;   ///< Life of the other end; 0 if no message has come.
  std::uint64_t newest_ = 0;  ///< Greatest message number received from that life.
  Vec3 there_ = Vec3::Zero();
  double silence_ = 0.0;  ///< Time since the newest message [s].
  double given_ = 0.0;    ///< Energy given to that life [J].
  double taken_ = 0.0;    ///< Energy taken from that life [J].

  double energy_;
  double lowest_ = 0.0;  ///< Lowest energy of the tank in this debt [J].
  double trust_ = 1.0;   ///< Share of the force that a tank in debt allows.
  /// Energy of the whole spring [J]. The other end fills the tank up to `start` + held_.
  double held_ = 0.0;
  double presence_ = 0.0;
  double paid_ = 1.0;
  NewReadings readings_;
  bool known_ = false;
  Vec3 last_ = Vec3::Zero();
  double span_ = 0.0;          ///< Time since the last position [s].
  double before_ = 0.0;        ///< Time between the last two readings [s].
  double mean_ = 0.0;          ///< Mean time between recent readings [s].
  Vec3 force_ = Vec3::Zero();  ///< Force since the last position [N].
  Vec3 sent_ = Vec3::Zero();
  double least_ = 0.0;     ///< Smallest share of the force that was sent.
  double reserved_ = 0.0;  ///< Upper bound of the work of the force until the next reading [J].
};

}  // namespace palpate
