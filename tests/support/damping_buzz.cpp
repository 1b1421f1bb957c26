#include "tests/support/damping_buzz.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "palpate/devices/simulated/simulated_device.h"
#include "tests/support/buzz.h"

namespace palpate::bench {

double buzzOf(const DampedPress& press) {
  constexpr double kSeconds = 4.0;
  constexpr double kHeard = 100.0;  // lower limit of the measured frequencies [Hz]
  // mean depth of the hand's target [m]
  constexpr double kDeep = 6e-3;
  constexpr double kWay = 10e-3 / (2.0 * std::numbers::pi);
  constexpr double kTremor = 1e-4;
  const auto turn = [](double hertz, double t) {
    return std::sin(2.0 * std::numbers::pi * hertz * t);
  };
  const auto target = [&](double t) -> Vec3 {
    return {0.0, 0.0, -kDeep - kWay * turn(1.0, t) - kTremor * turn(9.0, t)};
  };
  ArmParams arm;
  arm.coulomb = 0.0;
  arm.encoder = press.encoder;
  arm.tank = TankUse::kOff;
  SimulatedDevice device(arm, {}, {target, kSeconds}, press.rate);
  const CouplingParams coupling{500.0, press.damping};
  LengthRate rate(press.rate_time);
  std::vector<Vec3> forces;
  while (!device.ended()) {
    const Vec3 offset(0.0, 0.0, std::max(0.0, -device.read().position.z()));
    forces.push_back(couplingForce(coupling, offset, rate.next(offset.norm(), 1.0 / press.rate)));
    device.write(forces.back());
  }
  return std::sqrt(powerAbove(forces, kHeard, press.rate));
}

}  // namespace palpate::bench
