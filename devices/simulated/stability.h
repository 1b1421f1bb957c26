/// Computes how stiff a coupling an arm can render: the sampled loop of arm, hand and wall, for one
/// axis. docs/stability.md has the formulas, docs/passivity.md derives them.
#pragma once

#include <Eigen/Core>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/balance/coupling.h"

namespace palpate {

/// A delay as whole periods of 1/rate and a remainder of 0 to 1 period.
struct DelayInPeriods {
  int whole = 0;      ///< Whole periods; one that lacks 1e-9 counts as whole.
  double part = 0.0;  ///< Remainder, as a share of a period.
};
/// Converts a delay [s], >= 0, at a rate [Hz].
[[nodiscard]] DelayInPeriods inPeriods(double delay, double rate) noexcept;

/// Motion of an axis over a time with a constant commanded force: maps (x, v, f, u) to the next (x,
/// v, f), exactly. f is the amplifier's force, u its command; without lag f = u. Does not include
/// Coulomb friction or the hand's target.
using AxisStep = Eigen::Matrix<double, 3, 4>;
/// Returns the step of an arm in a hand over `time` [s], by the matrix exponential of the axis's
/// equations.
[[nodiscard]] AxisStep axisStep(const ArmParams& arm, const GripParams& grip, double time);

/// Returns the number of periods of 1/rate nearest to a time [s], at least one. The damper's rate
/// is taken over them (LengthRate).
[[nodiscard]] int rateSpan(double rate, double rate_time) noexcept;

/// Returns the matrix of an axis against a wall R = stiffness x_k + damping (x_k - x_{k-n}) / (n T)
/// that it never leaves, with T = 1/rate, n = rateSpan(rate, rate_time). It maps one sample to the
/// next, with all delayed forces. No encoder, no Coulomb friction. The arm's delay may include
/// parts of a period.
[[nodiscard]] Eigen::MatrixXd closedLoop(const ArmParams& arm, const GripParams& grip, double rate,
                                         double stiffness, double damping,
                                         double rate_time = kRateTime);
/// Returns the largest absolute eigenvalue of closedLoop; below 1 the loop settles.
[[nodiscard]] double growth(const ArmParams& arm, const GripParams& grip, double rate,
                            double stiffness, double damping, double rate_time = kRateTime);

/// Returns the least stiffness at which that loop does not settle [N/m], to 1e-9 of it. 0: it
/// settles at no stiffness. Infinite: it settles at all that were tried, up to a thousand times
/// what mass, friction and hand amount to in a tick. Takes a few milliseconds; with many periods of
/// delay seconds.
[[nodiscard]] double stableStiffness(const ArmParams& arm, const GripParams& grip, double rate,
                                     double damping = 0.0, double rate_time = kRateTime);

/// Returns the stiffness up to which no hand, whether a spring and damper or a machine, can extract
/// energy from the wall [N/m]; 0: at no stiffness. Exact without damping and, for a rate over one
/// period, for damping < 0 and for no delay (Colgate and Schenkel); else on the safe side.
/// Amplifier lag counts as that much delay, on the safe side. For encoder steps see quietStiffness.
[[nodiscard]] double passiveStiffness(const ArmParams& arm, double rate, double damping = 0.0);

/// Returns the stiffness up to which Coulomb friction absorbs the encoder's steps [N/m]: 2 c / D,
/// less the part that damping takes. Above it the arm may vibrate by a step.
[[nodiscard]] double quietStiffness(const ArmParams& arm, double rate, double damping = 0.0,
                                    double rate_time = kRateTime);

/// Returns the amplitude up to which a released arm's swing in the wall decays instead of growing
/// [m]. Up to it Coulomb friction suffices where viscous friction alone does not. Infinite if
/// viscous friction suffices; 0 without Coulomb friction.
[[nodiscard]] double holdingAmplitude(const ArmParams& arm, double rate, double stiffness);

/// Stability margins of a coupling on an arm. Always show them together: with `passive` alone,
/// users would choose couplings that are too soft.
struct CouplingRoom {
  double passive = 0.0;    ///< passiveStiffness [N/m]
  double stable = 0.0;     ///< stableStiffness with a hand [N/m]
  double amplitude = 0.0;  ///< holdingAmplitude at the coupling's stiffness [m]
  double rate = 0.0;       ///< Rate at which the coupling would be passive [Hz]; 0: at no rate.
  double viscous = 0.0;    ///< Viscous friction at which it would be passive [N s/m].
};
/// Returns the margins of a coupling of `stiffness` [N/m], > 0, and `damping` [N s/m], in a loop of
/// `rate` [Hz]. Milliseconds.
[[nodiscard]] CouplingRoom roomFor(const ArmParams& arm, const GripParams& grip, double rate,
                                   double stiffness, double damping);

}  // namespace palpate
