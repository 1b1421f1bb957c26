#include "palpate/devices/simulated/stability.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <unsupported/Eigen/MatrixFunctions>

#include <Eigen/Eigenvalues>

namespace palpate {

DelayInPeriods inPeriods(double delay, double rate) noexcept {
  const double periods = delay * rate;
  const double whole = std::floor(periods + 1e-9);
  return {static_cast<int>(whole), std::max(0.0, periods - whole)};
}

AxisStep axisStep(const ArmParams& arm, const GripParams& grip, double time) {
  // d/dt of (x, v, f, u), with constant u.
  Eigen::Matrix4d rates = Eigen::Matrix4d::Zero();
  rates(0, 1) = 1.0;
  rates(1, 0) = -grip.stiffness / arm.mass;
  rates(1, 1) = -(arm.viscous + grip.damping) / arm.mass;
  const bool lags = arm.lag > 0.0;
  rates(1, lags ? 2 : 3) = 1.0 / arm.mass;
  if (lags) {
    rates(2, 2) = -1.0 / arm.lag;
    rates(2, 3) = 1.0 / arm.lag;
  }
  const Eigen::Matrix4d scaled = rates * time;
  AxisStep step = scaled.exp().topRows<3>();
  if (!lags) step.row(2) << 0.0, 0.0, 0.0, 1.0;
  return step;
}

int rateSpan(double rate, double rate_time) noexcept {
  return std::max(1, static_cast<int>(std::lround(std::min(rate_time * rate, 1e6))));
}

Eigen::MatrixXd closedLoop(const ArmParams& arm, const GripParams& grip, double rate,
                           double stiffness, double damping, double rate_time) {
  const int span = rateSpan(rate, rate_time);
  const DelayInPeriods delay = inPeriods(arm.delay, rate);
  const AxisStep early = axisStep(arm, grip, delay.part / rate);
  const AxisStep late = axisStep(arm, grip, (1.0 - delay.part) / rate);
  // State: x, v, f, then the earlier readings on which the pending commands depend.
  const int readings = delay.whole + 1 + span;
  Eigen::MatrixXd loop = Eigen::MatrixXd::Zero(3 + readings, 3 + readings);
  loop.topLeftCorner<3, 3>() = late.leftCols<3>() * early.leftCols<3>();
  const auto reading = [](int ago) { return ago == 0 ? 0 : 2 + ago; };
  const auto order = [&](const Eigen::Vector3d& effect, int ago) {
    loop.block<3, 1>(0, reading(ago)) -= effect * (stiffness + damping * rate / span);
    loop.block<3, 1>(0, reading(ago + span)) += effect * (damping * rate / span);
  };
  order(late.col(3), delay.whole);
  if (delay.part > 0.0) order(late.leftCols<3>() * early.col(3), delay.whole + 1);
  loop(3, 0) = 1.0;
  for (int i = 4; i < 3 + readings; ++i) loop(i, i - 1) = 1.0;
  return loop;
}

double growth(const ArmParams& arm, const GripParams& grip, double rate, double stiffness,
              double damping, double rate_time) {
  return closedLoop(arm, grip, rate, stiffness, damping, rate_time)
      .eigenvalues()
      .cwiseAbs()
      .maxCoeff();
}

double stableStiffness(const ArmParams& arm, const GripParams& grip, double rate, double damping,
                       double rate_time) {
  // Without damping the command does not depend on earlier readings.
  const double back = damping == 0.0 ? 0.0 : rate_time;
  const auto rests = [&](double k) { return growth(arm, grip, rate, k, damping, back) < 1.0; };
  // Without friction, no mass settles at the stiffness 4 m / T^2. An arm that friction or a hand
  // stops within a tick may be stable up to multiples of that stiffness.
  const double inertial = 4.0 * arm.mass * rate * rate;
  const double stiffest = 1e3 * (inertial + (arm.viscous + grip.damping) * rate + grip.stiffness);
  const double step = std::pow(10.0, 0.05);
  double low = 1e-6 * inertial;
  if (!rests(low)) return 0.0;
  double high = step * low;
  for (; rests(high); high *= step) {
    if (high > stiffest) return std::numeric_limits<double>::infinity();
    low = high;
  }
  while (high - low > 1e-9 * high) {
    const double middle = 0.5 * (low + high);
    (rests(middle) ? low : high) = middle;
  }
  return low;
}

double passiveStiffness(const ArmParams& arm, double rate, double damping) {
  const double left = arm.viscous - std::abs(damping);
  if (!(left > 0.0)) return 0.0;
  // Solves b - |B| = K (T/2 + t_d) + K^2 T^2 phi (1 - phi) / (4 b) for K. B is the coupling's
  // damping, phi the delay's fraction of a period. A lag acts like a mixture of delays, so the
  // worst fraction is used.
  const double part = arm.lag > 0.0 ? 0.5 : inPeriods(arm.delay, rate).part;
  const double late = 0.5 / rate + arm.delay + arm.lag;
  const double q = part * (1.0 - part) / (rate * rate * 4.0 * arm.viscous);
  return 2.0 * left / (late + std::sqrt(late * late + 4.0 * q * left));
}

double quietStiffness(const ArmParams& arm, double rate, double damping, double rate_time) {
  if (!(arm.encoder > 0.0)) return std::numeric_limits<double>::infinity();
  return std::max(0.0, 2.0 * (arm.coulomb / arm.encoder -
                              std::abs(damping) * rate / rateSpan(rate, rate_time)));
}

double holdingAmplitude(const ArmParams& arm, double rate, double stiffness) {
  const double lacks = stiffness * (0.5 / rate + arm.delay + arm.lag) - arm.viscous;
  if (lacks <= 0.0) return std::numeric_limits<double>::infinity();
  return 4.0 * arm.coulomb / (M_PI * std::sqrt(stiffness / arm.mass) * lacks);
}

CouplingRoom roomFor(const ArmParams& arm, const GripParams& grip, double rate, double stiffness,
                     double damping) {
  CouplingRoom room;
  room.passive = passiveStiffness(arm, rate, damping);
  room.stable = stableStiffness(arm, grip, rate, damping);
  room.amplitude = holdingAmplitude(arm, rate, stiffness);
  // Searches in steps of 1 %. The delay's fraction of a period changes with the rate, so there is
  // no closed form.
  constexpr double kFastest = 1e5;  // [Hz]
  double faster = rate;
  while (faster <= kFastest && passiveStiffness(arm, faster, damping) < stiffness) faster *= 1.01;
  room.rate = faster <= kFastest ? faster : 0.0;
  ArmParams more = arm;
  double low = 0.0;
  double high = 1.0;
  const auto lacks = [&](double viscous) {
    more.viscous = viscous;
    return passiveStiffness(more, rate, damping) < stiffness;
  };
  while (lacks(high)) high *= 2.0;  // the passive stiffness rises with friction
  while (high - low > 1e-6 * high) {
    const double middle = 0.5 * (low + high);
    (lacks(middle) ? low : high) = middle;
  }
  room.viscous = high;
  return room;
}

}  // namespace palpate
