#include "tests/support/contact_problems.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <memory>
#include <numbers>
#include <vector>

#include <Eigen/Geometry>

#include "palpate/engine/loop/realtime.h"
#include "palpate/engine/tick/step.h"
#include "tests/support/corner_noise.h"
#include "tests/support/motion_problems.h"
#include "tests/support/random.h"
#include "tests/support/theorem.h"

namespace palpate::bench {

using test::Random;

double ContactResult::offRms() const {
  return converged > 0 ? std::sqrt(off_squares / static_cast<double>(converged)) : 0.0;
}

namespace {

/// A hand on a surface, with its measurements.
class Touch {
 public:
  Touch(const FieldPtr& field, double strength, const ContactRuns& runs, ContactResult& result)
      : result_(result),
        probed_(std::get<0>(field)),
        strength_(strength),
        tolerance_(runs.step.tolerance_voxels) {
    ModeSpec mode;
    mode.kind = runs.kind;
    mode.of = "it";
    mode.strength = strength;
    mode.solid = Solid::kBelow;
    GraphSpec spec;
    spec.modes = {mode};
    scene_ = makeScene(spec, {{"it", field}}, {kMotionStiffness, 0.0}, runs.step);
    ++result_.runs;
  }

  void operator()(const Vec3& hand) {
    constexpr double kHeld = 1e-6;  // [N]
    const std::int64_t start = nowNs();
    const StepReport report = provenStep(*scene_, reader_, {kVoxel * hand}, state_, kMotionTick);
    const std::int64_t took = nowNs() - start;
    const Vec3 proxy = report.proxy / kVoxel;
    const double force = report.force.norm();
    moved_ = (proxy - proxy_).norm();
    proxy_ = proxy;
    capped_ = report.status == StepStatus::kSubstepLimit;
    result_.hardest = std::max(result_.hardest, force / strength_);
    if (force > 1.05 * strength_) ++result_.over;
    if (!(force > kHeld)) return;
    ++result_.held;
    if (!proving()) result_.times.push_back(static_cast<double>(took));
    result_.readings += report.substeps;
    result_.cells += report.walked;
    if (capped_) {
      ++result_.capped;
    } else if (force < 0.999 * strength_) {
      ++result_.converged;
      const double off = std::abs(probed_.off(proxy, 0.0));
      result_.off_most = std::max(result_.off_most, off);
      result_.off_squares += off * off;
      if (off > tolerance_) ++result_.off;
    }
  }

  /// Keeps the hand at rest for 150 ms.
  void hold(const Vec3& hand) {
    ++result_.holds;
    bool stands = true;
    for (int t = 0; t < 150; ++t) {
      (*this)(hand);
      if (t >= 130) stands = stands && capped_ && moved_ < tolerance_;
    }
    if (stands) ++result_.unfinished;
  }
  [[nodiscard]] const Vec3& proxy() const { return proxy_; }
  /// Returns a negative number if the proxy is behind the true and the interpolated surface: the
  /// signed distance from the nearer one [voxels]. `free` is that from the true surface.
  [[nodiscard]] double behind(double free) {
    return free < 0.0 ? std::max(free, probed_.off(proxy_, 0.0)) : free;
  }

 private:
  ContactResult& result_;
  Probed probed_;
  double strength_;
  double tolerance_;
  std::unique_ptr<const Scene> scene_;
  Reader reader_;
  ProxyState state_{ForceLimits{1e3, 1e12}};
  Vec3 proxy_ = Vec3::Zero();
  double moved_ = 0.0;
  bool capped_ = false;
};

Mat3 anyFrame(Random& random) {
  const double angle = random.uniform(0.0, 6.28);
  return Eigen::Quaterniond(Eigen::AngleAxisd(angle, random.direction())).toRotationMatrix();
}

/// Returns a random point on V = 0 in the cube around `middle` with an edge of 2 `reach`.
Vec3 onSurface(Probed& probed, const Vec3& middle, double reach, Random& random) {
  for (;;) {
    Vec3 a = middle + random.inCube(reach);
    Vec3 b = middle + random.inCube(reach);
    if (probed.value(a) < 0.0) std::swap(a, b);
    if (probed.value(a) < 0.0 || probed.value(b) >= 0.0) continue;
    for (int n = 0; n < 60; ++n) {
      const Vec3 m = 0.5 * (a + b);
      (probed.value(m) < 0.0 ? b : a) = m;
    }
    return a;
  }
}

constexpr double kReach = 22.0;  // half edge of the cube in which a wandering hand starts [voxels]

/// Moves a hand at random below the surface. `free` returns the distance to the true surface.
void wander(const std::function<double(const Vec3&)>& free, const FieldPtr& field,
            const Vec3& middle, const ContactRuns& runs, Random& random, ContactResult& result,
            double most = 4.0) {
  Probed probed(std::get<0>(field));
  const auto normal = [&](const Vec3& p) {
    Vec3 g;
    for (int a = 0; a < 3; ++a) {
      const Vec3 e = 0.5 * Vec3::Unit(a);
      g[a] = probed.value(p + e) - probed.value(p - e);
    }
    return Vec3(g.normalized());
  };
  Touch touch(field, 1e3, runs, result);
  const Vec3 x = onSurface(probed, middle, kReach, random);
  const Vec3 out = normal(x);
  for (int i = 0; i < 20; ++i) touch(x + (0.5 - 0.05 * i) * out);
  const double depth = random.uniform(std::min(1.0, 0.5 * most), most);
  const double pace = random.uniform(0.1, 0.6);
  Vec3 hand = x - 0.5 * out;
  Vec3 going = random.direction();
  double deepest = 0.0;
  for (int t = 0; t < 400; ++t) {
    const Vec3 p = touch.proxy();
    const Vec3 n = normal(p);
    going += 0.1 * random.inCube(1.7);
    going = (going - n * n.dot(going)).normalized();
    hand += pace * going;
    const Vec3 off = hand - p;
    const double farthest = 1.25 * depth;
    if (off.norm() > farthest) hand = p + off * (farthest / off.norm());
    hand -= 0.1 * n * (depth - std::min(depth, n.dot(p - hand)));
    if ((p - middle).cwiseAbs().maxCoeff() > kReach + 4.0) break;
    touch(hand);
    deepest = std::min(deepest, touch.behind(free(touch.proxy())));
  }
  result.deepest = std::min(result.deepest, deepest);
  if (deepest < -1.0) ++result.leaked;
  touch.hold(hand);
}

constexpr int kRoom = 64;  // edge of the volume of a wandering hand [voxels]
const Vec3 kMiddle = Vec3::Constant(0.5 * (kRoom - 1));

}  // namespace

ContactResult feelGrooves(double opening, const ContactRuns& runs) {
  ContactResult result;
  Random random(runs.seed);
  constexpr std::array kSpeeds{0.02, 0.1, 0.5, 2.0};  // [m/s]
  for (long f = 0; f < runs.frames; ++f) {
    const Mat3 frame = anyFrame(random);
    const Vec3 edge = Vec3(24, 24, 24) + random.inCube(0.5);
    const double half = opening * std::numbers::pi / 360.0;
    const Vec3 a = frame * Vec3(std::sin(half), std::cos(half), 0.0);
    const Vec3 b = frame * Vec3(std::sin(half), -std::cos(half), 0.0);
    const auto free = [&](const Vec3& p) { return std::min(a.dot(p - edge), b.dot(p - edge)); };
    Touch touch(scalarGrid(48, free), 20.0, runs, result);
    const double pace = voxelsPerTick(kSpeeds[static_cast<std::size_t>(f) % kSpeeds.size()]);
    const double deep = random.uniform(1.0, 4.0);
    constexpr double kAbove = 8.0;
    const double down = kAbove + deep;
    const long ticks = static_cast<long>(down / pace) + 1500;
    double deepest = 0.0;
    Vec3 hand = edge;
    for (long t = 0; t < ticks; ++t) {
      const double way = pace * static_cast<double>(t);
      const double past = std::max(way - down, 0.0);
      hand = edge + frame * Vec3(std::max(kAbove - way, -deep), 1.5 * std::sin(0.21 * past),
                                 6.0 * std::asin(std::sin(past / 6.0)));
      touch(hand);
      deepest = std::min(deepest, touch.behind(free(touch.proxy())));
    }
    touch.hold(hand);
    result.deepest = std::min(result.deepest, deepest);
    if (deepest < -1.0) ++result.leaked;
  }
  return result;
}

ContactResult feelBalls(double radius, const ContactRuns& runs) {
  ContactResult result;
  Random random(runs.seed);
  for (long f = 0; f < runs.frames; ++f) {
    const Vec3 middle = kMiddle + random.inCube(0.5);
    const auto free = [&](const Vec3& p) { return (p - middle).norm() - radius; };
    wander(free, scalarGrid(kRoom, free), middle, runs, random, result,
           std::min(4.0, 0.6 * radius));
  }
  return result;
}

ContactResult feelCubes(bool hollow, const ContactRuns& runs) {
  ContactResult result;
  Random random(runs.seed);
  for (long f = 0; f < runs.frames; ++f) {
    const Mat3 frame = anyFrame(random);
    const Vec3 middle = kMiddle + random.inCube(0.5);
    const auto free = [&](const Vec3& p) {
      const double off = (frame * (p - middle)).cwiseAbs().maxCoeff() - 12.0;
      return hollow ? -off : off;
    };
    wander(free, scalarGrid(kRoom, free), middle, runs, random, result);
  }
  return result;
}

ContactResult feelNoise(double wavelength, const ContactRuns& runs) {
  struct Wave {
    Vec3 k;
    double phase;
  };
  constexpr int kWaves = 60;
  ContactResult result;
  Random random(runs.seed);
  for (long f = 0; f < runs.frames; ++f) {
    std::vector<Wave> waves;
    for (int i = 0; i < kWaves; ++i) {
      const double length = wavelength * (1.0 + 0.3 * random.uniform(-1.0, 1.0));
      waves.push_back({2.0 * std::numbers::pi / length * random.direction(),
                       std::numbers::pi * random.uniform(-1.0, 1.0)});
    }
    const auto value = [&](const Vec3& p) {
      double sum = 0.0;
      for (const Wave& wave : waves) sum += std::cos(wave.k.dot(p) + wave.phase);
      return -2.0 * sum / std::sqrt(static_cast<double>(kWaves));
    };
    const FieldPtr field = scalarGrid(kRoom, value, "trilinear", false);
    Probed probed(std::get<0>(field));
    wander([&](const Vec3& p) { return probed.off(p, 0.0); }, field, kMiddle, runs, random, result);
  }
  return result;
}

ContactResult pressNoise(double grain, const ContactRuns& runs) {
  constexpr int kSide = 48;
  constexpr std::size_t kCorners = 64;
  constexpr int kPresses = 20;
  const Vec3 middle = Vec3::Constant(0.5 * (kSide - 1));
  ContactResult result;
  Random random(runs.seed);
  for (long f = 0; f < runs.frames; ++f) {
    std::vector<double> corners(kCorners * kCorners * kCorners);
    for (double& corner : corners) corner = 0.3 + random.uniform(-1.0, 1.0);
    const auto value = [&](const Vec3& p) {
      // Adds height beyond 18 voxels from the middle, so that the edge of the grid is free space.
      const double border = (p - middle).cwiseAbs().maxCoeff();
      return grain * betweenCorners(corners, kCorners, p / grain) +
             2.0 * std::max(0.0, border - 18.0);
    };
    const FieldPtr field = scalarGrid(kSide, value, "trilinear", false);
    for (int p = 0; p < kPresses; ++p) {
      Touch touch(field, 3.0, runs, result);
      const Vec3 from = middle + 40.0 * random.direction();
      const Vec3 way = 1.6 * (middle + random.inCube(8.0) - from);
      const double pace = voxelsPerTick(random.logUniform(0.02, 0.5));
      const long ticks = static_cast<long>(way.norm() / pace);
      for (long t = 0; t < ticks; ++t) {
        touch(from + way * (static_cast<double>(t) / static_cast<double>(ticks)));
      }
    }
  }
  return result;
}

}  // namespace palpate::bench
