/// The energy tank: what has come out of the hand's port, and the most force that it can pay for.
/// Whatever hand, scene and method there are, an arm with at least the friction that is relied on
/// never gives a hand more energy than it has put in (docs/passivity.md has the proof).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "palpate/engine/types.h"

namespace palpate {

/// What is relied on of an arm, every number from its safe side.
struct ArmDissipation {
  double viscous =
      0.0;  ///< b [N s/m], at most the arm's, > 0: without it no force can be paid for.
  double coulomb = 0.0;  ///< c [N], at most the arm's, less what the force that acts may differ
                         ///< from the one that was sent (rounding to the motors' steps).
  double step = 0.0;     ///< D [m]: a position that is read is within D/2 of the arm's. Of three
                         ///< encoders of one step it is sqrt(3) of them.
  double delay = 0.0;    ///< From a reading to the force that follows from it [s], the middle, and
  double doubt = 0.0;    ///< how far off it may be to either side [s], at most `delay`. Every force
                         ///< may be late by another time, or be built up within it, but none
                         ///< overtakes another.
  double jitter = 0.0;   ///< How long before or after the middle a position may have been made [s];
                         ///< part of the doubt, at most it.
  double lag = 0.0;      ///< Time constant of the amplifiers, of first order [s].
  double period = 0.0;   ///< The longest time between two ticks [s], > 0; later ones may be debts.
                         ///< 0: HapticLoop puts its own.
};

enum class TankUse : std::uint8_t {
  kOff,      ///< Nothing is counted.
  kObserve,  ///< The energy is counted, the force let through.
  kAct,      ///< The force is made smaller, its direction kept, where it cannot be paid for.
};

struct TankParams {
  TankUse use = TankUse::kOff;
  ArmDissipation arm;
  double soft = 100.0;  ///< It holds what a spring of this stiffness holds at the peak force [N/m].
  double refill = 0.0;  ///< Most that primitives which do work (moving volumes, directed forces,
                        ///< re-anchored walls) may add [W].
};

/// A force that acts from some time on, as the amplifier was told it.
struct SentForce {
  Vec3 force = Vec3::Zero();  ///< [N]
  double from = 0.0;          ///< [s] after the last tick, in the middle of the doubt.
  double change = 0.0;        ///< From the force before: |difference| [N],
  double jump = 0.0;          ///< |difference of the squares| [N^2].
};

/// The tank of one arm. Forces are those on the hand, as everywhere in the engine; energy that the
/// hand has put in counts positive.
class Tank {
 public:
  /// The energy that is certainly there [J]; below zero only where the tank observes.
  [[nodiscard]] double energy() const noexcept { return sure_; }
  /// What could not be paid, all together [J]: ticks later than ArmDissipation::period. By so much
  /// the guarantee is weaker. It is forgiven: the tank goes on as if it had been paid.
  [[nodiscard]] double debt() const noexcept { return debt_; }
  /// What has been added from outside, all together [J].
  [[nodiscard]] double refilled() const noexcept { return refilled_; }

  /// The largest share of `wanted` that can be paid for, and what is done about it.
  ///
  /// @param wanted  After every other limit [N], finite.
  /// @param hand    As read [m]; not finite, or where no hand is: nothing is known of it, and no
  ///                force can be paid for.
  /// @param fresh   Read since the last call; else it is the one of then, and says nothing of the
  ///                time between.
  /// @param dt      Since the last call [s].
  /// @param cap     The most that the tank holds [J].
  /// Returns the share, 1: all. Where the tank acts, share * wanted must be sent, else all of it.
  /// RT: no allocation. Cost: O(forces on their way), times 31 where the force is scaled: 0.1 us,
  /// scaled 0.6 to 1 (palpate_bench_passivity prints it).
  [[nodiscard]] double pass(const Vec3& wanted, const Vec3& hand, bool fresh, double dt,
                            const TankParams& params, double cap) noexcept PALPATE_NONBLOCKING;
  /// Adds energy that somebody answers for [J]; what is not positive adds nothing.
  void refill(double energy) noexcept PALPATE_NONBLOCKING;
  /// After pass(): of the force that it let be sent the motors give only this share, 0 to 1;
  /// outside that nothing changes. RT: no allocation.
  void weaken(double share, const ArmDissipation& arm) noexcept PALPATE_NONBLOCKING;
  /// To be called where zero is sent instead of what pass() let be sent, the position is not to be
  /// trusted, or the arm is another one. Begins anew, empty, and where it acts passes nothing until
  /// every force that may be on its way is over and a fresh position has come. RT: no allocation.
  void forget() noexcept;

  static constexpr std::size_t kForces = 64;  ///< That act or are on their way, at once; one more:
                                              ///< as forget().

 private:
  struct Amplifier;
  /// What the amplifier gives now; all of it follows the orders by the same lag.
  struct Acting {
    Vec3 force = Vec3::Zero();  ///< [N]
    double square = 0.0;        ///< At least the force's [N^2].
    double change = 0.0;        ///< How far the force may be from that, for its delay's doubt [N],
    double jump = 0.0;          ///< and the square [N^2].
  };
  /// Integrals of them, but for the last.
  struct Acted {
    Vec3 force = Vec3::Zero();  ///< [N s]
    double square = 0.0;        ///< [N^2 s]
    double change = 0.0;        ///< [N s]
    double most = 0.0;          ///< The largest change [N].
  };
  /// A time is over: the forces that acted in it.
  void elapse(double dt, const ArmDissipation& arm) noexcept;
  /// Those whose delays' doubt falls into it.
  void elapseDoubt(double dt, const ArmDissipation& arm) noexcept;
  /// A position is read: what has been brought since the last one.
  void arrive(const Vec3& hand, const ArmDissipation& arm) noexcept;
  /// What is certainly there of what was counted at a reading just now [J].
  [[nodiscard]] double certain(const ArmDissipation& arm) const noexcept;
  /// The most that can still leave if `next` is sent now and zero from the next tick on [J].
  [[nodiscard]] double reserve(const Vec3& next, const ArmDissipation& arm) const noexcept;
  /// `force` is on its way.
  void send(const Vec3& force, const ArmDissipation& arm) noexcept;

  double sure_ = 0.0;     ///< At most what is there now [J].
  double counted_ = 0.0;  ///< What there was at the last reading, but for what stays open [J].
  double debt_ = 0.0;
  double refilled_ = 0.0;
  bool known_ = false;          ///< There is a last position, and nothing unknown has acted since.
  bool recovers_ = false;       ///< Forces may be on their way that nobody knows of,
  double blind_ = 0.0;          ///< for so long [s].
  Vec3 last_ = Vec3::Zero();    ///< The last position [m].
  Vec3 anchor_ = Vec3::Zero();  ///< Of the play operator that Coulomb's path is counted by [m].
  Acted since_;                 ///< The last reading,
  double span_ = 0.0;           ///< so long ago [s].
  double recent_ = 0.0;         ///< At least the force's square for as long as a reading's jitter.
  Vec3 mean_ = Vec3::Zero();    ///< The force between the last two readings [N].
  Acting acting_;
  /// Ascending: those that act or have acted and may not yet, then those on their way. Never none.
  std::array<SentForce, kForces> sent_{};
  std::size_t count_ = 1;
};

}  // namespace palpate
