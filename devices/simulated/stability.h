/// Computes the largest stiffness that an arm can render, from the sampled loop of arm, hand and
/// wall, for one axis. docs/stability.md has the formulas, docs/passivity.md derives them.
#pragma once

#include <Eigen/Core>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/balance/coupling.h"

namespace palpate {

/// A delay as whole periods of 1/rate and a remainder of 0 to 1 period.
struct DelayInPeriods {
  /// Number of whole periods; a remainder above 1 - 1e-9 counts as a whole period.
  int whole = 0;
  double part = 0.0;  ///< Remainder, as a share of a period.
};
/// Converts a delay [s], >= 0, at a rate [Hz].
[[nodiscard]] DelayInPeriods inPeriods(double delay, double rate) noexcept;

/// Motion of an axis over a time with a constant commanded force. Maps (x, v, f, u) to the next (x,
/// v, f), exactly. f is the amplifier's force, u its command; without lag f = u. Does not include
/// Coulomb friction or the motion of the hand's target.
using AxisStep = Eigen::Matrix<double, 3, 4>;
/// Returns the step of an arm in a hand over `time` [s], by a matrix exponential.
[[nodiscard]] AxisStep axisStep(const ArmParams& arm, const GripParams& grip, double time);

/// Returns the number of periods of 1/rate nearest to a time [s], at least one. The damper computes
/// its velocity over this many periods (LengthRate).
[[nodiscard]] int rateSpan(double rate, double rate_time) noexcept;

/// Returns the matrix that maps the state of an axis at one sample to the next. The state includes
/// the earlier readings on which delayed forces depend. The wall is
/// R = stiffness x_k + damping (x_k - x_{k-n}) / (n T), with T = 1/rate and
/// n = rateSpan(rate, rate_time); the axis stays in contact. Ignores encoder steps and Coulomb
/// friction.
[[nodiscard]] Eigen::MatrixXd closedLoop(const ArmParams& arm, const GripParams& grip, double rate,
                                         double stiffness, double damping,
                                         double rate_time = kRateTime);
/// Returns the largest absolute eigenvalue of closedLoop; below 1 the loop settles.
[[nodiscard]] double growth(const ArmParams& arm, const GripParams& grip, double rate,
                            double stiffness, double damping, double rate_time = kRateTime);

/// Returns the smallest stiffness at which the closed loop does not settle [N/m], with a relative
/// error of 1e-9. Searches upwards in steps of 12 %, from 1e-6 times 4 m / T^2. 0: the loop does
/// not settle at the first step. Infinite: it settles up to the end of the search, 1000 (4 m / T^2
/// + (b + b_h) / T + k_h). Takes a few milliseconds, or seconds if the delay has many periods.
[[nodiscard]] double stableStiffness(const ArmParams& arm, const GripParams& grip, double rate,
                                     double damping = 0.0, double rate_time = kRateTime);

/// Returns the stiffness up to which no hand can extract energy from the wall [N/m]; 0: at no
/// stiffness. Without amplifier lag, exact for no damping; also exact for damping < 0 and for no
/// delay, if the damper's velocity is taken over one period (Colgate and Schenkel). Otherwise a
/// lower bound; amplifier lag counts as an equal delay. For encoder steps see quietStiffness.
[[nodiscard]] double passiveStiffness(const ArmParams& arm, double rate, double damping = 0.0);

/// Returns the stiffness up to which Coulomb friction absorbs the encoder's steps [N/m]: 2 c / D,
/// less the part that damping needs. Above this stiffness the arm may vibrate by one step. Infinite
/// without encoder steps.
[[nodiscard]] double quietStiffness(const ArmParams& arm, double rate, double damping = 0.0,
                                    double rate_time = kRateTime);

/// Returns the amplitude up to which Coulomb friction damps the swing of a released arm against the
/// wall [m]. Infinite if viscous friction suffices alone; 0 without Coulomb friction.
[[nodiscard]] double holdingAmplitude(const ArmParams& arm, double rate, double stiffness);

/// Stability margins of a coupling on an arm. A coupling that is limited by `passive` alone is
/// softer than necessary.
struct CouplingRoom {
  double passive = 0.0;    ///< passiveStiffness [N/m]
  double stable = 0.0;     ///< stableStiffness of the arm in a hand [N/m]
  double amplitude = 0.0;  ///< holdingAmplitude at the coupling's stiffness [m]
  /// First rate at which the coupling is passive, from the given rate to 100 kHz in steps of 1 %
  /// [Hz]; 0: none.
  double rate = 0.0;
  double viscous = 0.0;  ///< Least viscous friction at which the coupling would be passive [N s/m].
};
/// Returns the margins. `stiffness` [N/m], > 0; `damping` [N s/m]; `rate` [Hz]. Takes as long as
/// stableStiffness.
[[nodiscard]] CouplingRoom roomFor(const ArmParams& arm, const GripParams& grip, double rate,
                                   double stiffness, double damping);

}  // namespace palpate
