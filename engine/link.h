/// A spring between this hand's proxy and that of a hand elsewhere, over a network that may delay,
/// lose, double and reorder whatever it carries.
///
/// Each end renders the spring by itself, from where it last heard the other to be, and pays for it
/// out of a tank of its own: the hand there fills it (by the work that it does on the spring) and
/// empties it, and what one end has to spare it gives to the other. It says so by the sum of all
/// that it ever gave: whoever hears the sum takes what is in it above what he has taken. A message
/// that is lost is made up for by the next one, one that comes twice or late says nothing new.
///
/// With w_i(t) the work that end i has done on its hand, g_i what it gave, and r_i what it took of
/// what the other gave, tank i holds e_i = start + r_i - g_i - w_i. As r_1 <= g_2 and r_2 <= g_1,
///
///     w_1 + w_2  =  2 start - e_1 - e_2 + (r_1 - g_2) + (r_2 - g_1)  <=  2 start - e_1 - e_2,
///
/// and as neither tank is let below zero the two hands together never get more than `start` each,
/// which is what it takes to lift 100 g by 1 mm. There is no model of the network in this.
///
/// A reading is within D/2 of the hand, D being the encoders' step. So the work that readings show
/// differs from w_i. With F_k the force sent after reading k and e_k its error, by parts
///
///     sum F_k . (e_k+1 - e_k)  =  F_n . e_n+1 - sum (F_k - F_k-1) . e_k
///                             <=  D/2 (|F_n| + sum |F_k - F_k-1|) :
///
/// each change of the force pays D/2 |F_k - F_k-1| when it is sent, and D/2 |F_n| stays reserved.
///
/// There is one model of the hand: until the next reading it goes on as it went, but for
/// kLinkNimble, and that reading comes in time. A late one, or a hand that hits something, lets a
/// force do more than was reserved: a tank below zero lets out half as much as before each time it
/// comes lower, and the whole force only when the debt is paid. So any number of debts come to at
/// most twice the first one's force over a tick's way.
#pragma once

#include <cstdint>

#include "palpate/engine/device.h"
#include "palpate/engine/types.h"

namespace palpate {

/// How a hand elsewhere is felt.
struct LinkParams {
  double stiffness = 200.0;  ///< k [N/m], > 0.
  double peak = 2.0;         ///< The most that it pulls [N], > 0.
  double start = 1e-3;       ///< What a tank holds at first [J], >= 0.
  double step = 2e-4;        ///< D [m], >= 0: a position that is read is within D/2 of the hand's
                             ///< (ArmDissipation::step). The default is more than that of desktop
                             ///< arms; each change of the force costs the more, the larger it is.
};

inline constexpr double kLinkSilence = 0.2;  ///< Of whom so long nothing is heard, he is away [s].
inline constexpr double kLinkRamp = 0.5;     ///< The spring comes and goes in so long [s].
inline constexpr double kLinkRise = 0.1;  ///< A force that could not be paid for comes back in [s].
/// More than a hand is accelerated by [m/s^2]: what a tank lasts for is its way until the next
/// tick.
inline constexpr double kLinkNimble = 200.0;

/// What an end tells the other.
///
/// A life is an end from its beginning, or from its other one's being forgotten, on: a later one
/// has a greater number, and a program that is started anew as well. A sum is one life's to one
/// life, and begins at 0; who hears of a later life begins a new one.
struct LinkWord {
  std::uint64_t from = 0;  ///< The teller's life; 0: nobody.
  std::uint64_t to =
      0;  ///< Whose it is: the life of the other, which no other takes; 0: none is known.
  std::uint64_t number = 0;   ///< The greatest is the newest of this life.
  Vec3 proxy = Vec3::Zero();  ///< The teller's [m], in the scene.
  double given = 0.0;         ///< All that it has given to that life [J].
};

/// One end of the spring.
class Link {
 public:
  /// @param life  Not 0, and greater than that of each end before it in the same place.
  explicit Link(std::uint64_t life, const LinkParams& params = {}) noexcept
      : params_(params), life_(life), energy_(params.start) {}

  /// Takes a message, any bits, in any order, any number of times. RT: no allocation.
  void hear(const LinkWord& word) noexcept PALPATE_NONBLOCKING;
  /// From here on it is another one who is heard, of any life. The tank stays what it is.
  void forgetOther() noexcept;

  /// A tick: counts what the last force did on the hand's way, and gives the force for the next.
  /// Between two readings of the hand it stays, as nobody can say what another one would do.
  ///
  /// @param proxy  This hand's proxy [m].
  /// @param hand   The hand: as it was read, fresh or not, and where its motors can push.
  /// @param part   Of the spring, that is this end's: it is one of several at the hand.
  /// @param dt     Time since the last call [s].
  /// @return       |force| <= part * peak [N], finite, along hand.drives; 0 where hand or dt is no
  ///               usable number.
  /// RT: no allocation. Cost: some ten nanoseconds.
  [[nodiscard]] Vec3 pull(const Vec3& proxy, const HandState& hand, double part,
                          double dt) noexcept PALPATE_NONBLOCKING;
  /// Call it after each pull(): `share` of the force has left, 0 to 1; below 0: it is unknown.
  /// What a force takes out of the tank is counted as if all of it had.
  void pulled(double share) noexcept PALPATE_NONBLOCKING;
  /// To be called in place of pull() where no force goes to a hand. The last one has acted until
  /// now.
  void rest(const Vec3& hand) noexcept PALPATE_NONBLOCKING;

  /// What the other end is to hear, the proxy's place [m] included. RT: no allocation.
  [[nodiscard]] LinkWord word(const Vec3& proxy) noexcept PALPATE_NONBLOCKING;

  [[nodiscard]] double energy() const noexcept { return energy_; }  ///< In the tank [J].
  /// Share of the spring that is there, 0 to 1.
  [[nodiscard]] double presence() const noexcept { return presence_; }
  /// Share of the last force that the tank could pay for.
  [[nodiscard]] double paid() const noexcept { return paid_; }

 private:
  /// It is this life that is heard from here on, and nothing was given or taken yet.
  void begin(std::uint64_t other) noexcept;
  /// Counts what the force did until the hand was there [m].
  void count(const Vec3& hand) noexcept;
  /// Pays for a change of the force that has left [N].
  void change(const Vec3& to) noexcept;

  LinkParams params_;
  std::uint64_t life_;
  std::uint64_t told_ = 0;  ///< Words so far.

  std::uint64_t other_ = 0;   ///< The other's life; 0: nobody was heard.
  std::uint64_t newest_ = 0;  ///< The greatest number heard of it.
  Vec3 there_ = Vec3::Zero();
  double silence_ = 0.0;  ///< Since the newest word [s].
  double given_ = 0.0;    ///< To that life [J].
  double taken_ = 0.0;    ///< Of what it gave [J].

  double energy_;
  double lowest_ = 0.0;  ///< Where the tank was since it was in debt [J].
  double trust_ = 1.0;   ///< Share of the force that a tank in debt lets out.
  double held_ =
      0.0;  ///< What the whole spring holds [J]: there is no use for more from elsewhere.
  double presence_ = 0.0;
  double paid_ = 1.0;
  NewReadings readings_;
  bool known_ = false;         ///< There is a last position.
  Vec3 last_ = Vec3::Zero();   ///< The last position [m].
  double span_ = 0.0;          ///< Time since then [s].
  double before_ = 0.0;        ///< Time between the two readings before [s],
  double mean_ = 0.0;          ///< and between all of late [s].
  Vec3 force_ = Vec3::Zero();  ///< Since then [N],
  Vec3 sent_ = Vec3::Zero();   ///< what of it has left last [N],
  double least_ = 0.0;         ///< of which at least this share has left,
  double reserved_ = 0.0;      ///< and what it was held to take at most [J].
};

}  // namespace palpate
