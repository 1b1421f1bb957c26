/// A spring between this hand's proxy and that of a remote hand, over a network that may delay,
/// lose, double and reorder messages.
///
/// Each end renders the spring by itself, from the last place that it heard of the other end. It
/// pays for the spring out of its own energy tank. Its own hand fills that tank by the work that it
/// does on the spring, and empties it. An end gives its spare energy to the other end. It
/// sends the sum of all energy that it ever gave. The receiver takes the part of the sum that it
/// has not taken yet. So the next message makes up for a lost one, and a doubled or late message
/// adds no energy.
///
/// With w_i(t) the work that end i has done on its hand, g_i the energy that it gave, and r_i the
/// energy that it took from the other end, tank i holds e_i = start + r_i - g_i - w_i. As
/// r_1 <= g_2 and r_2 <= g_1,
///
///     w_1 + w_2  =  2 start - e_1 - e_2 + (r_1 - g_2) + (r_2 - g_1)  <=  2 start - e_1 - e_2.
///
/// Neither tank may fall below zero. So the two hands together never get more than `start` each,
/// which is the energy that lifts 100 g by 1 mm. This needs no model of the network.
///
/// A reading is within D/2 of the hand, D being the encoders' step. So the work by the readings
/// differs from w_i. With F_k the force sent after reading k and e_k its error, by parts
///
///     sum F_k . (e_k+1 - e_k)  =  F_n . e_n+1 - sum (F_k - F_k-1) . e_k
///                             <=  D/2 (|F_n| + sum |F_k - F_k-1|) :
///
/// each change of the force pays D/2 |F_k - F_k-1| when it is sent, and D/2 |F_n| stays reserved.
///
/// There is one model of the hand: until the next reading it continues as it moved, except for
/// kLinkNimble, and that reading comes in time. If the reading is late, or if the hand hits
/// something, a force can do more than was reserved. A tank below zero halves the force that it
/// lets out each time it reaches a new low. It lets out the whole force only when the debt is paid.
/// So all debts together are at most twice the work of the first debt's force over a tick's path.
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
                             ///< (ArmDissipation::step). The default is more than that of desktop
                             ///< arms. The larger D is, the more each change of the force costs.
};

inline constexpr double kLinkSilence = 0.2;  ///< A hand that is silent for this long is away [s].
inline constexpr double kLinkRamp = 0.5;     ///< The spring fades in and out in this time [s].
inline constexpr double kLinkRise = 0.1;     ///< A force that could not be paid for returns in this
                                             ///< time [s].
/// More than the acceleration of a hand [m/s^2]. The tank must last for the hand's path until the
/// next tick.
inline constexpr double kLinkNimble = 200.0;

/// A message from one end to the other.
///
/// A life of an end begins when the end is made, and when it forgets the other end. A later life
/// has a greater number, also after a restart of the program. A sum belongs to one life of each
/// end, and begins at 0. An end that hears of a later life begins a new sum.
struct LinkWord {
  std::uint64_t from = 0;  ///< The sender's life; 0: no sender.
  std::uint64_t to =
      0;  ///< Life of the receiver; another life does not take the word. 0: none is known.
  std::uint64_t number = 0;   ///< The greatest number is the newest word of this life.
  Vec3 proxy = Vec3::Zero();  ///< The sender's proxy [m], in the scene.
  double given = 0.0;         ///< Sum of the energy given to that life [J].
};

/// One end of the spring.
class Link {
 public:
  /// @param life  Not 0, and greater than that of each end before it in the same place.
  explicit Link(std::uint64_t life, const LinkParams& params = {}) noexcept
      : params_(params), life_(life), energy_(params.start) {}

  /// Receives a message: any bits, in any order, any number of times. RT: no allocation.
  void hear(const LinkWord& word) noexcept PALPATE_NONBLOCKING;
  /// Forgets the other end; the next one heard may have any life. The tank stays as it is.
  void forgetOther() noexcept;

  /// Runs a tick: counts the work of the last force over the hand's path, and returns the next
  /// force. Between two readings of the hand the force stays, because the work of another one is
  /// unknown.
  ///
  /// @param proxy  This hand's proxy [m].
  /// @param hand   The hand: as it was read, fresh or not, and where its motors can push.
  /// @param part   This end's part of the spring, if the hand has several springs.
  /// @param dt     Time since the last call [s].
  /// @return       |force| <= part * peak [N], finite, along hand.drives; 0 if hand or dt is not a
  ///               usable number.
  /// RT: no allocation. Cost: some ten nanoseconds.
  [[nodiscard]] Vec3 pull(const Vec3& proxy, const HandState& hand, double part,
                          double dt) noexcept PALPATE_NONBLOCKING;
  /// Call it after each pull(): `share` of the force has left, 0 to 1; below 0: the share is
  /// unknown. The energy that a force takes out of the tank is counted as if all of the force had
  /// left.
  void pulled(double share) noexcept PALPATE_NONBLOCKING;
  /// Call it instead of pull() if no force goes to a hand. The last force has acted until now.
  void rest(const Vec3& hand) noexcept PALPATE_NONBLOCKING;

  /// Returns the message for the other end, with the proxy's place [m]. RT: no allocation.
  [[nodiscard]] LinkWord word(const Vec3& proxy) noexcept PALPATE_NONBLOCKING;

  [[nodiscard]] double energy() const noexcept { return energy_; }  ///< Energy in the tank [J].
  /// Returns the share of the spring that is present, 0 to 1.
  [[nodiscard]] double presence() const noexcept { return presence_; }
  /// Returns the share of the last force that the tank could pay for.
  [[nodiscard]] double paid() const noexcept { return paid_; }

 private:
  /// Listens to this life from here on; no energy was given or taken yet.
  void begin(std::uint64_t other) noexcept;
  /// Counts the work of the force until the hand was at `hand` [m].
  void count(const Vec3& hand) noexcept;
  /// Pays for a change of the force that has left [N].
  void change(const Vec3& to) noexcept;

  LinkParams params_;
  std::uint64_t life_;
  std::uint64_t told_ = 0;  ///< Number of words so far.

  std::uint64_t other_ = 0;   ///< Life of the other end; 0: no other end was heard.
  std::uint64_t newest_ = 0;  ///< Greatest number heard from that life.
  Vec3 there_ = Vec3::Zero();
  double silence_ = 0.0;  ///< Time since the newest word [s].
  double given_ = 0.0;    ///< Energy given to that life [J].
  double taken_ = 0.0;    ///< Energy taken from that life [J].

  double energy_;
  double lowest_ = 0.0;  ///< Lowest energy of the tank in this debt [J].
  double trust_ = 1.0;   ///< Share of the force that a tank in debt lets out.
  double held_ =
      0.0;  ///< Energy of the whole spring [J]; the tank has no use for more from the other end.
  double presence_ = 0.0;
  double paid_ = 1.0;
  NewReadings readings_;
  bool known_ = false;         ///< There is a last position.
  Vec3 last_ = Vec3::Zero();   ///< The last position [m].
  double span_ = 0.0;          ///< Time since the last position [s].
  double before_ = 0.0;        ///< Time between the two readings before [s].
  double mean_ = 0.0;          ///< Mean time between recent readings [s].
  Vec3 force_ = Vec3::Zero();  ///< Force since the last position [N].
  Vec3 sent_ = Vec3::Zero();   ///< Part of the force that left last [N].
  double least_ = 0.0;         ///< Least share of the force that has left.
  double reserved_ = 0.0;      ///< Work that the force was expected to take at most [J].
};

}  // namespace palpate
