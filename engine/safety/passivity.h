/// The energy tank: it counts the energy at the hand's port and finds the largest force that this
/// energy can pay for. For any hand, scene and method, an arm with at least the assumed friction
/// never gives a hand more energy than the hand has put in (docs/passivity.md has the proof).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "palpate/engine/types.h"

namespace palpate {

/// Dissipation and timing of an arm that the tank assumes, every number from its safe side.
struct ArmDissipation {
  double viscous =
      0.0;  ///< b [N s/m], at most the arm's, > 0: without it the tank can pay for no force.
  double coulomb = 0.0;  ///< c [N], at most the arm's, less the possible difference between the
                         ///< force that acts and the one that was sent (rounding to the motors'
                         ///< steps).
  double step = 0.0;     ///< D [m]: a position that is read is within D/2 of the arm's. For three
                         ///< encoders of one step each, D is sqrt(3) steps.
  double delay = 0.0;    ///< Time from a reading to the force computed from it [s], mid-range.
  double doubt = 0.0;    ///< Half the range of the delay [s], at most `delay`. Each force may have
                         ///< its own delay in that range, or be built up within the range, but no
                         ///< force overtakes another.
  double jitter = 0.0;   ///< Largest deviation of a position's time from its mid-range time [s];
                         ///< included in `doubt`, at most all of it.
  double lag = 0.0;      ///< Time constant of the amplifiers, of first order [s].
  double period = 0.0;   ///< The longest time between two ticks [s], > 0; later ticks may make
                         ///< debts. 0: HapticLoop sets its own.
};

/// Action of the tank if its energy does not pay for a force.
enum class TankUse : std::uint8_t {
  kOff,      ///< The tank does not count.
  kObserve,  ///< The energy is counted; the force is let through.
  kAct,      ///< The force is reduced, its direction kept, if the tank cannot pay for it.
};

/// Use of the tank of one device, and the numbers that it assumes.
struct TankParams {
  TankUse use = TankUse::kOff;  ///< Unless kOff, `arm` must have viscous > 0.
  ArmDissipation arm;           ///< Dissipation of the arm, and timing of its forces.
  double soft = 100.0;          ///< Stiffness [N/m]: the capacity is the energy of a spring of this
                                ///< stiffness at peak force.
  double refill = 0.0;          ///< Largest power that primitives which do work (moving volumes,
                                ///< directed forces, re-anchored walls) may add [W].
};

/// A force as sent to the amplifier. It acts from some time on.
struct SentForce {
  Vec3 force = Vec3::Zero();  ///< [N]
  double from = 0.0;          ///< Time after the last tick when it begins to act, mid-range [s].
  double change = 0.0;        ///< |difference| from the force before [N].
  double jump = 0.0;          ///< |difference of the squares| from the force before [N^2].
};

/// The tank of one arm. Forces are those on the hand, as everywhere in the engine; energy that the
/// hand has put in counts positive.
class Tank {
 public:
  /// Returns the energy that is certainly in the tank [J]; below zero only if the tank observes.
  [[nodiscard]] double energy() const noexcept { return sure_; }
  /// Returns the energy that could not be paid so far [J], because of ticks later than
  /// ArmDissipation::period. The guarantee is weaker by this much. A debt is forgiven: the tank
  /// continues as if it were paid.
  [[nodiscard]] double debt() const noexcept { return debt_; }
  /// Returns the energy that has been added from outside so far [J].
  [[nodiscard]] double refilled() const noexcept { return refilled_; }

  /// Finds the largest share of `wanted` that the tank can pay for, and counts the sent force.
  ///
  /// @param wanted  The force after every other limit [N], finite.
  /// @param hand    Position of the hand as read [m]. If it is not finite, or beyond 1e6 m, it is
  ///                not known, and the tank can pay for no force.
  /// @param fresh   True if `hand` was read since the last call. Else it is that of the last call,
  ///                and gives no information on the time between.
  /// @param dt      Time since the last call [s].
  /// @param cap     The most energy that the tank holds [J].
  /// @return        The share, 0 to 1. If the tank acts, send share * wanted, else all of wanted.
  /// RT: no allocation. Cost: O(forces on their way), times 31 if the force is scaled: 0.1 us,
  /// scaled 0.6 to 1 (palpate_bench_passivity prints it).
  [[nodiscard]] double pass(const Vec3& wanted, const Vec3& hand, bool fresh, double dt,
                            const TankParams& params, double cap) noexcept PALPATE_NONBLOCKING;
  /// Adds energy that the caller accounts for [J], if it is finite and > 0.
  void refill(double energy) noexcept PALPATE_NONBLOCKING;
  /// Call this after pass() if the motors give only this share, 0 to 1, of the force that was let
  /// through. A share outside that range is ignored. RT: no allocation.
  void weaken(double share, const ArmDissipation& arm) noexcept PALPATE_NONBLOCKING;
  /// Call this if zero is sent instead of the force that pass() let through, if the position cannot
  /// be trusted, or if the arm is another one. The tank restarts, empty. If it acts, no force
  /// passes until every old one is surely over and a fresh position has come. RT: no allocation.
  void forget() noexcept;

  static constexpr std::size_t kForces = 64;  ///< Most forces that act or are on their way at once;
                                              ///< with one more the tank forgets, as by forget().

 private:
  struct Amplifier;
  /// Output of the amplifier now. It lags the sent force by ArmDissipation::lag.
  struct Acting {
    Vec3 force = Vec3::Zero();  ///< [N]
    double square = 0.0;        ///< At least |force|^2 [N^2].
    double change = 0.0;        ///< Possible error of `force`, by the doubt in its delay [N].
    double jump = 0.0;          ///< Possible error of `square`, by the same doubt [N^2].
  };
  /// Integrals of Acting over time; `most` is a maximum.
  struct Acted {
    Vec3 force = Vec3::Zero();  ///< [N s]
    double square = 0.0;        ///< [N^2 s]
    double change = 0.0;        ///< [N s]
    double most = 0.0;          ///< The largest Acting::change [N].
  };
  /// Advances by `dt` [s] and counts the forces that acted in it.
  void elapse(double dt, const ArmDissipation& arm) noexcept;
  /// Counts the forces that, by the doubt in their delays, may switch within `dt` [s].
  void elapseDoubt(double dt, const ArmDissipation& arm) noexcept;
  /// Takes a position that was read, and counts the energy brought since the last one.
  void arrive(const Vec3& hand, const ArmDissipation& arm) noexcept;
  /// Returns the certain part of the energy counted at a reading just now [J].
  [[nodiscard]] double certain(const ArmDissipation& arm) const noexcept;
  /// Returns the most energy that can still leave if `next` is sent now and zero from the next tick
  /// on [J].
  [[nodiscard]] double reserve(const Vec3& next, const ArmDissipation& arm) const noexcept;
  /// Records `force` as on its way.
  void send(const Vec3& force, const ArmDissipation& arm) noexcept;

  double sure_ = 0.0;     ///< Lower bound of the energy in the tank now [J].
  double counted_ = 0.0;  ///< Energy at the last reading, open terms not yet deducted [J].
  double debt_ = 0.0;
  double refilled_ = 0.0;
  bool known_ = false;          ///< There is a last position, and no unknown force has acted since.
  bool recovers_ = false;       ///< Unknown forces may be on their way.
  double blind_ = 0.0;          ///< Time for which these forces may still act [s].
  Vec3 last_ = Vec3::Zero();    ///< The last position [m].
  Vec3 anchor_ = Vec3::Zero();  ///< Anchor of the play operator that counts Coulomb's path [m].
  Acted since_;                 ///< Integrals since the last reading.
  double span_ = 0.0;           ///< Time since the last reading [s].
  double recent_ = 0.0;         ///< At least |force|^2 for as long as a reading's jitter [N^2].
  Vec3 mean_ = Vec3::Zero();    ///< The mean force between the last two readings [N].
  Acting acting_;
  /// Forces, ascending in time: those that act or may act now, then those on their way. Never
  /// empty.
  std::array<SentForce, kForces> sent_{};
  std::size_t count_ = 1;
};

}  // namespace palpate
