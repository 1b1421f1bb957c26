/// The energy tank counts the energy that the arm and the hand exchange, and limits the force to
/// what this energy can pay for. If the arm has at least the assumed friction and timing, the hand
/// gets at most the energy that it has put in, plus refilled() and debt(). Proof:
/// docs/passivity.md.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "palpate/engine/types.h"

namespace palpate {

/// Dissipation and timing of an arm, as the tank assumes them. The numbers must be conservative.
struct ArmDissipation {
  double viscous = 0.0;  ///< Viscous damping b [N s/m]: > 0, at most that of the arm. Without it
                         ///< a tank that acts allows no force.
  double coulomb =
      0.0;  ///< Coulomb friction c [N], at most that of the arm. Subtract the possible difference
            ///< between the acting force and the sent one, such as the motors' rounding.
  double step = 0.0;  ///< D [m]: each position reading is within D/2 of the arm. For three encoders
                      ///< of one step, D is sqrt(3) steps.
  double delay =
      0.0;  ///< Time from a reading to the effect of its force [s], at the middle of its range.
  double doubt =
      0.0;  ///< Half the range of the delay [s], at most `delay`. Each force may have another delay
            ///< in the range, or build up within it, but no force overtakes another.
  double jitter = 0.0;  ///< Largest deviation of a reading's time from the middle of its range [s];
                        ///< a part of `doubt`.
  double lag = 0.0;     ///< First-order time constant of the amplifiers [s].
  double period = 0.0;  ///< Longest time between two ticks [s]; later ticks may cause debts.
                        ///< If 0, HapticLoop sets it.
};

/// Action of the tank if its energy cannot pay for a force.
enum class TankUse : std::uint8_t {
  kOff,      ///< The tank does not count energy.
  kObserve,  ///< The tank counts the energy, but does not reduce the force.
  kAct,      ///< The tank reduces a force that it cannot pay for, and keeps its direction.
};

/// Parameters of the tank of one device.
struct TankParams {
  TankUse use = TankUse::kOff;  ///< If not kOff, arm.viscous must be > 0.
  ArmDissipation arm;           ///< Dissipation of the arm, and timing of its forces.
  double soft = 100.0;  ///< Stiffness that sets the capacity [N/m]: the energy of a spring with
                        ///< this stiffness at peak force.
  double refill = 0.0;  ///< Largest power that may be added for primitives that do work [W]: moving
                        ///< volumes, directed forces and re-anchored walls.
};

/// A force that was sent to the amplifier, and the time at which it begins to act.
struct SentForce {
  Vec3 force = Vec3::Zero();  ///< Force sent [N].
  double from = 0.0;          ///< Time from the last tick to the force's start, at mid-range [s].
  double change = 0.0;        ///< Magnitude of the difference from the force before [N].
  double jump = 0.0;          ///< Magnitude of the difference of |force|^2 [N^2].
};

/// The tank of one arm. Forces act on the hand. Energy from the hand counts as positive.
class Tank {
 public:
  /// Returns a lower bound of the energy in the tank [J]; below zero only if the tank observes.
  [[nodiscard]] double energy() const noexcept { return sure_; }
  /// Returns the energy that could not be paid so far [J], as after ticks later than
  /// ArmDissipation::period. The guarantee is weaker by this amount. The tank continues as if the
  /// debt were paid.
  [[nodiscard]] double debt() const noexcept { return debt_; }
  /// Returns the energy that refill() has added so far [J].
  [[nodiscard]] double refilled() const noexcept { return refilled_; }

  /// Finds the largest share of `wanted` that the tank can pay for, and counts the sent force.
  ///
  /// @param wanted  The force after all other limits [N], finite.
  /// @param hand    Position of the hand as read [m]. If not finite, or beyond 1e6 m, it counts as
  ///                unknown, and the tank cannot pay for a force.
  /// @param fresh   True if `hand` was read since the last call; false for a repetition.
  /// @param dt      Time since the last call [s].
  /// @param cap     Capacity of the tank [J].
  /// @return        The share, 0 to 1. If the tank acts, send share * wanted, else all of wanted.
  /// RT: no allocation. Cost: O(forces on their way): 0.1 us, or 0.6 to 1 us if the force is scaled
  /// (palpate_bench_passivity).
  [[nodiscard]] double pass(const Vec3& wanted, const Vec3& hand, bool fresh, double dt,
                            const TankParams& params, double cap) noexcept PALPATE_NONBLOCKING;
  /// Adds energy [J] for which the caller accounts. Ignores a number that is not finite or not > 0.
  void refill(double energy) noexcept PALPATE_NONBLOCKING;
  /// Corrects the last counted force. Call this function after pass() if the motors apply only this
  /// share, 0 to 1, of the allowed force. Ignores a share outside that range. RT: no allocation.
  void weaken(double share, const ArmDissipation& arm) noexcept PALPATE_NONBLOCKING;
  /// Restarts the tank empty. Call this function if zero is sent instead of the allowed force, if
  /// the position may be wrong, or if the arm was replaced. If the tank acts, it allows no force
  /// until all old forces are certainly over and a fresh position was read. RT: no allocation.
  void forget() noexcept;

  /// Largest number of forces that act or are on their way. If so many remain at the next call of
  /// pass(), the tank calls forget().
  static constexpr std::size_t kForces = 64;

 private:
  struct Amplifier;
  /// Present output of the amplifier, which lags behind the sent force by ArmDissipation::lag.
  struct Acting {
    Vec3 force = Vec3::Zero();
    double square = 0.0;  ///< Upper bound of |force|^2 [N^2].
    double change = 0.0;  ///< Possible error of `force` because its delay is uncertain [N].
    double jump = 0.0;    ///< Possible error of `square` for the same reason [N^2].
  };
  /// Integrals of the members of Acting over time, and one maximum.
  struct Acted {
    Vec3 force = Vec3::Zero();
    double square = 0.0;
    double change = 0.0;
    double most = 0.0;  ///< The largest Acting::change [N].
  };
  /// Advances by `dt` [s] and counts the forces that acted.
  void elapse(double dt, const ArmDissipation& arm) noexcept;
  /// Counts the forces that may begin to act within `dt` [s], because their delays are uncertain.
  void elapseDoubt(double dt, const ArmDissipation& arm) noexcept;
  /// Processes a new position, and counts the energy since the previous position.
  void arrive(const Vec3& hand, const ArmDissipation& arm) noexcept;
  /// Returns the certain part of the energy, if there is a reading at this moment [J].
  [[nodiscard]] double certain(const ArmDissipation& arm) const noexcept;
  /// Returns the largest energy that can leave the tank if `next` and then zero is sent [J].
  [[nodiscard]] double reserve(const Vec3& next, const ArmDissipation& arm) const noexcept;
  void send(const Vec3& force, const ArmDissipation& arm) noexcept;

  double sure_ = 0.0;     ///< Lower bound of the present energy in the tank [J].
  double counted_ = 0.0;  ///< Energy at the last reading, before uncertain terms are deducted [J].
  double debt_ = 0.0;
  double refilled_ = 0.0;
  bool known_ = false;  ///< True if there is a last position, and no unknown force has acted since.
  bool recovers_ = false;  ///< True if unknown forces may be on their way.
  double blind_ = 0.0;     ///< Time for which unknown forces may still act [s].
  Vec3 last_ = Vec3::Zero();
  Vec3 anchor_ =
      Vec3::Zero();           ///< Anchor of the play operator for the path of Coulomb friction [m].
  Acted since_;               ///< Integrals since the last reading.
  double span_ = 0.0;         ///< Time since the last reading [s].
  double recent_ = 0.0;       ///< Upper bound of |force|^2 within a reading's jitter [N^2].
  Vec3 mean_ = Vec3::Zero();  ///< The mean force between the last two readings [N].
  Acting acting_;
  /// Forces in the order of time: those that act or may act, then those on their way. Never empty.
  std::array<SentForce, kForces> sent_{};
  std::size_t count_ = 1;
};

}  // namespace palpate
