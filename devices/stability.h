/// How stiff a coupling an arm can give: the sampled loop of arm, hand and wall, one axis of it.
/// docs/stability.md has the formulas, docs/passivity.md derives them.
#pragma once

#include <Eigen/Core>

#include "palpate/devices/simulated_device.h"
#include "palpate/engine/coupling.h"

namespace palpate {

/// A delay in whole periods of 1/rate, and what is left: 0 to 1 of one.
struct DelayInPeriods {
  int whole = 0;      ///< Whole periods; one that lacks 1e-9 counts as whole.
  double part = 0.0;  ///< What is left, as a share of a period.
};
/// A delay [s], >= 0, at a rate [Hz].
[[nodiscard]] DelayInPeriods inPeriods(double delay, double rate) noexcept;

/// What an axis does in a time over which its force is ordered the same: the next (x, v, f) of
/// (x, v, f, u), exactly. f is the force that the amplifier gives, u its order; without lag f = u.
/// Coulomb's friction is not in it, nor the hand's target.
using AxisStep = Eigen::Matrix<double, 3, 4>;
/// Of an arm in a hand over `time` [s], by the matrix exponential of the axis's equations.
[[nodiscard]] AxisStep axisStep(const ArmParams& arm, const GripParams& grip, double time);

/// The periods of 1/rate that are nearest to a time [s], at least one: what the damper's rate is
/// taken over (LengthRate).
[[nodiscard]] int rateSpan(double rate, double rate_time) noexcept;

/// The loop of an axis against a wall R = stiffness x_k + damping (x_k - x_{k-n}) / (n T) that it
/// never leaves, T = 1/rate, n = rateSpan(rate, rate_time): from one sample to the next, with all
/// forces on their way. No encoder, no Coulomb friction. The arm's delay may be parts of a period.
[[nodiscard]] Eigen::MatrixXd closedLoop(const ArmParams& arm, const GripParams& grip, double rate,
                                         double stiffness, double damping,
                                         double rate_time = kRateTime);
/// The largest size of its eigenvalues: below 1 it comes to rest.
[[nodiscard]] double growth(const ArmParams& arm, const GripParams& grip, double rate,
                            double stiffness, double damping, double rate_time = kRateTime);

/// The least stiffness at which that loop does not come to rest [N/m], to 1e-9 of it; 0: not at
/// any; infinite: at any that was tried, to a thousand times what mass, friction and hand make of a
/// tick. Takes a few milliseconds, with many periods of delay seconds.
[[nodiscard]] double stableStiffness(const ArmParams& arm, const GripParams& grip, double rate,
                                     double damping = 0.0, double rate_time = kRateTime);

/// The stiffness up to which no hand at all, nothing but a spring and damper or a machine, can get
/// energy out of the wall [N/m]; 0: not at any. Exact without damping and, for a rate over one
/// period, for damping < 0 and for no delay (Colgate and Schenkel), else on the safe side.
/// Amplifier lag counts as that much delay, on the safe side. Reads of an encoder: see
/// quietStiffness.
[[nodiscard]] double passiveStiffness(const ArmParams& arm, double rate, double damping = 0.0);

/// The stiffness up to which Coulomb's friction swallows the encoder's steps [N/m]: 2 c / D, less
/// what damping takes. Above it the arm may hum by a step.
[[nodiscard]] double quietStiffness(const ArmParams& arm, double rate, double damping = 0.0,
                                    double rate_time = kRateTime);

/// How far a released arm may swing in the wall before it swings up instead of down: Coulomb's
/// friction holds up to here where viscous friction alone does not [m]. Infinite where that does; 0
/// without Coulomb friction.
[[nodiscard]] double holdingAmplitude(const ArmParams& arm, double rate, double stiffness);

/// A coupling on an arm in three numbers, always shown together: the first alone would make every
/// arm feel soft.
struct CouplingRoom {
  double passive = 0.0;    ///< passiveStiffness [N/m]
  double stable = 0.0;     ///< stableStiffness with a hand [N/m]
  double amplitude = 0.0;  ///< holdingAmplitude at the coupling's stiffness [m]
  double rate = 0.0;       ///< At which the coupling's stiffness would be passive [Hz]; 0: at none.
  double viscous = 0.0;    ///< Friction of the arm with which it would be [N s/m].
};
/// Of a coupling of `stiffness` [N/m], > 0, and `damping` [N s/m], in a loop of `rate` [Hz].
/// Milliseconds.
[[nodiscard]] CouplingRoom roomFor(const ArmParams& arm, const GripParams& grip, double rate,
                                   double stiffness, double damping);

}  // namespace palpate
