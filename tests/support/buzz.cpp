#include "tests/support/buzz.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <complex>
#include <functional>
#include <numbers>
#include <unsupported/Eigen/FFT>
#include <utility>

#include "palpate/devices/simulated/simulated_device.h"
#include "tests/support/motion_problems.h"

namespace palpate::bench {

namespace {

constexpr double kRate = 1.0 / kMotionTick;  // [Hz]
constexpr double kStrength = 3.0;            // [N]
constexpr double kDepth = 2e-3;              // [m]
// how much deeper the path is for BuzzHand::kHeld [m]
constexpr double kDeeper = 1e-3;
constexpr double kFollows = 5.0;       // fastest change that a hand follows [Hz]
constexpr double kSeconds = 5.0;       // duration of a slice [s]
constexpr int kApproach = 300;         // number of ticks of the approach from outside
constexpr double kOutside = 4e-3;      // distance from the skin at which the approach begins [m]
constexpr std::size_t kSettled = 500;  // number of ticks at the start that do not count
constexpr double kStep = 25e-6;        // encoder step [m]
constexpr double kTurning = 0.08;      // radius that converts speed to angular speed [m]

using Path = std::vector<Vec3>;

/// Low-passes values forwards and then backwards, both twice, which causes no delay.
void lowPass(std::vector<double>& values) {
  const double share = 1.0 - std::exp(-2.0 * std::numbers::pi * kFollows / kRate);
  const auto pass = [&](auto begin, auto end) {
    double y = *begin;
    for (auto it = begin; it != end; ++it) *it = y += share * (*it - y);
  };
  for (int i = 0; i < 2; ++i) {
    pass(values.begin(), values.end());
    pass(values.rbegin(), values.rend());
  }
}

Path pathAround(const ScalarField& field, const SkinWay& way, double sign, const Vec3& axis,
                double first, double depth) {
  auto cache = std::make_unique<FieldCache>();
  field.reset(*cache);
  const auto n = static_cast<std::size_t>(kSeconds * kRate);
  const auto angle = [&](std::size_t i) {
    return first + way.speed / kTurning / kRate * static_cast<double>(i);
  };
  std::vector<double> radius(n);
  double last = kTurning;
  for (std::size_t i = 0; i < n; ++i) {
    const double r =
        skinRadius(field, way.level, sign, axis, angle(i), way.far, 0.1 * way.far, *cache);
    if (r > 0.0) last = r;
    radius[i] = last;
  }
  lowPass(radius);
  Path path;
  const auto at = [&](std::size_t i, double out) -> Vec3 {
    const double a = angle(i);
    return axis + (radius[i] + out) * Vec3(std::cos(a), std::sin(a), 0.0);
  };
  for (int i = 0; i < kApproach; ++i) {
    path.push_back(at(0, kOutside - (kOutside + depth) * i / kApproach));
  }
  for (std::size_t i = 0; i < n; ++i) path.push_back(at(i, -depth));
  return path;
}

using Force = std::function<Vec3(const Vec3& hand)>;

std::vector<Vec3> forcesAlong(const Path& path, BuzzHand hand, const Force& force) {
  std::vector<Vec3> forces;
  if (hand == BuzzHand::kHeld) {
    ArmParams arm;
    arm.mass = 0.15;
    arm.coulomb = 0.0;
    arm.encoder = 0.0;
    arm.delay = 0.0;
    arm.tank = TankUse::kOff;
    const auto target = [&](double t) -> Vec3 {
      const double at = std::clamp(t * kRate, 0.0, static_cast<double>(path.size() - 1));
      const auto i = std::min(static_cast<std::size_t>(at), path.size() - 2);
      return path[i] + (at - static_cast<double>(i)) * (path[i + 1] - path[i]);
    };
    SimulatedDevice device(arm, {300.0, 4.0}, {target, 1e9}, kRate);
    for (std::size_t i = 0; i < path.size(); ++i) {
      forces.push_back(force(device.read().position));
      device.write(forces.back());
    }
    return forces;
  }
  for (const Vec3& p : path) {
    const Vec3 read = hand == BuzzHand::kEncoder ? Vec3((p / kStep).array().round() * kStep) : p;
    forces.push_back(force(read));
  }
  return forces;
}

Buzz buzzOf(const std::vector<Vec3>& forces) {
  double mean = 0.0;
  for (std::size_t i = kSettled; i < forces.size(); ++i) mean += forces[i].norm();
  return {mean / static_cast<double>(forces.size() - kSettled), powerAbove(forces, 100.0, kRate)};
}

/// Returns the penalty force: k times the depth, at most 3 N, along the gradient. Reads value and
/// gradient at the hand. The depth is at most 6 mm.
Force penalty(const std::shared_ptr<const ScalarField>& field, double level, double sign,
              bool polynomial) {
  constexpr double kDeepest = 6e-3;  // [m]
  const auto cache = std::make_shared<FieldCache>();
  field->reset(*cache);
  return [=](const Vec3& hand) -> Vec3 {
    const ScalarSample s = field->sample(hand, *cache);
    const Vec3 slope = polynomial ? field->cellGradient(hand, *cache) : s.gradient;
    const double steep = slope.norm() / field->frame().metres_per_unit;
    const double inside = -sign * (s.value - level);
    if (!s.inside || !(inside > 0.0) || !(steep > 0.0)) return Vec3::Zero();
    const double size = kMotionStiffness * std::min(inside / steep, kDeepest);
    return sign * std::min(size, kStrength) * slope.normalized();
  };
}

class SteppedEngine {
 public:
  SteppedEngine(const std::shared_ptr<const ScalarField>& field, double level, bool above) {
    SurfaceMotion motion;
    motion.field = field;
    motion.level = level;
    motion.solid = above ? Solid::kAbove : Solid::kBelow;
    tick_ = engineOn(motion, ModeKind::kIsosurface, {}, kStrength);
  }
  Vec3 force(const Vec3& probe) {
    const Ticked r = tick_(probe);
    constexpr double kMuch = 4.0;    // proxy's path divided by the hand's
    constexpr double kAtAll = 5e-5;  // excess path of the proxy that does not count [m]
    const double way = (r.proxy - proxy_).norm();
    const bool settled = ticks_++ > kSettled;
    if (settled && way > kMuch * (probe - probe_).norm() + kAtAll) ++clicks_;
    proxy_ = r.proxy;
    probe_ = probe;
    return r.force;
  }
  [[nodiscard]] int clicks() const { return clicks_; }

 private:
  Stepper tick_;
  Vec3 proxy_ = Vec3::Zero();
  Vec3 probe_ = Vec3::Zero();
  std::size_t ticks_ = 0;
  int clicks_ = 0;
};

}  // namespace

double skinRadius(const ScalarField& field, double level, double sign, const Vec3& axis,
                  double angle, double far, double near, FieldCache& cache) {
  constexpr int kParts = 60;
  const Vec3 d(std::cos(angle), std::sin(angle), 0.0);
  Vec3 p = axis + far * d;
  for (int k = 1; k <= kParts; ++k) {
    const Vec3 q = axis + (far + (near - far) * k / kParts) * d;
    const Crossing crossing = field.firstFall(p, q, level, sign, cache);
    if (crossing.found) return (p + crossing.share * (q - p) - axis).norm();
    p = q;
  }
  return 0.0;
}

double powerAbove(const std::vector<Vec3>& forces, double least, double rate) {
  // Hann windows that overlap by half.
  constexpr std::size_t kWindow = 1024;
  constexpr double kHannPower = 0.375;
  Eigen::FFT<double> fft;
  double power = 0.0;
  int windows = 0;
  for (std::size_t s = kSettled; s + kWindow <= forces.size(); s += kWindow / 2) {
    for (int a = 0; a < 3; ++a) {
      double mean = 0.0;
      for (std::size_t i = 0; i < kWindow; ++i) mean += forces[s + i][a] / kWindow;
      std::vector<double> x(kWindow);
      for (std::size_t i = 0; i < kWindow; ++i) {
        const double phase = 2.0 * std::numbers::pi * static_cast<double>(i) / kWindow;
        x[i] = (forces[s + i][a] - mean) * (0.5 - 0.5 * std::cos(phase));
      }
      std::vector<std::complex<double>> spectrum;
      fft.fwd(spectrum, x);
      for (std::size_t i = 1; i < kWindow / 2; ++i) {
        if (static_cast<double>(i) * rate / kWindow >= least) power += std::norm(spectrum[i]);
      }
    }
    ++windows;
  }
  return windows == 0 ? 0.0 : 2.0 * power / (windows * kWindow * kWindow * kHannPower);
}

double quieter(const Buzz& one, const Buzz& other) {
  const auto relative = [](const Buzz& b) { return b.power / (b.force * b.force); };
  return 10.0 * std::log10(relative(other) / relative(one));
}

std::vector<Buzzes> feelBuzz(const std::shared_ptr<const ScalarField>& field, const SkinWay& way) {
  const double sign = way.above ? -1.0 : 1.0;
  const double depth = way.hand == BuzzHand::kHeld ? kDepth + kDeeper : kDepth;
  std::vector<Buzzes> all;
  for (int slice = 0; slice < way.slices; ++slice) {
    const double off = slice - 0.5 * (way.slices - 1);
    const Vec3 axis =
        field->frame().bounds.centre() + (way.raise + way.apart * off) * Vec3::UnitZ();
    const Path path = pathAround(*field, way, sign, axis, off, depth);
    Buzzes one;
    one.polynomial = buzzOf(forcesAlong(path, way.hand, penalty(field, way.level, sign, true)));
    one.continuous = buzzOf(forcesAlong(path, way.hand, penalty(field, way.level, sign, false)));
    SteppedEngine engine(field, way.level, way.above);
    one.engine =
        buzzOf(forcesAlong(path, way.hand, [&](const Vec3& probe) { return engine.force(probe); }));
    one.clicks = engine.clicks();
    all.push_back(one);
  }
  return all;
}

}  // namespace palpate::bench
