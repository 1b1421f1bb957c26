/// Measures the cost of a tick in contact with a ball that deforms, moves by keyframes, or is at
/// rest. The three take turns, so that other work of the machine affects all equally.
///
///     palpate_bench_warp [--turns N]
#include <cmath>
#include <cstdio>
#include <exception>
#include <map>
#include <numbers>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "bench/machine.h"
#include "palpate/samplers/time/warp_grid.h"
#include "tests/support/motion_problems.h"
#include "tests/support/percentiles.h"

using namespace palpate;
using namespace palpate::bench;

namespace {

constexpr double kRadius = 40.0;
const Vec3 kCentre(52.3, 51.7, 52.45);  // [voxels], centre of the ball
constexpr double kPeriod = 0.2;         // [s]
constexpr int kTicks = 400;             // per turn

/// Makes a warp that expands and contracts by a tenth: cells of 8 voxels, 16 frames per period.
WarpPtr breathing() {
  constexpr int kFrames = 16;
  DisplacementFrames out;
  out.size = {20, 20, 20};
  out.origin = kVoxel * (kCentre - Vec3::Constant(76.0));
  out.axes = 8.0 * kVoxel * Mat3::Identity();
  std::vector<double> times;
  for (int f = 0; f <= kFrames; ++f) {
    times.push_back(kPeriod * f / kFrames);
    const double size = 1.0 + 0.1 * std::sin(2.0 * std::numbers::pi * (f % kFrames) / kFrames);
    std::vector<float>& frame = out.frames.emplace_back();
    for (int n = 0; n < 8000; ++n) {
      const int i = n / 400;
      const int j = n / 20 % 20;
      const Vec3 x = out.origin + out.axes * Vec3(i, j, n % 20);
      const Vec3 u = (1.0 / size - 1.0) * (x - kVoxel * kCentre);
      for (int c = 0; c < 3; ++c) frame.push_back(static_cast<float>(u[c]));
    }
  }
  return makeWarp(out, {times, true}, "/warp");
}

/// Makes a motion to and fro, as far as the warp moves the surface.
MotionPtr shaking() {
  std::vector<Keyframe> keys(3);
  keys[1] = {0.5 * kPeriod, {1, 0, 0, 0}, Vec3(0.1 * kRadius * kVoxel, 0, 0)};
  keys[2].time = kPeriod;
  return std::make_shared<const Motion>(keys, true);
}

struct Felt {
  std::unique_ptr<const Scene> scene;
  std::unique_ptr<Reader> reader = std::make_unique<Reader>();
  std::unique_ptr<ProxyState> state = std::make_unique<ProxyState>(ForceLimits{1e3, 1e12});
  std::vector<double> times{};
  double readings = 0.0;
};

Felt felt(const FieldPtr& ball, const MotionPtr& motion) {
  GraphSpec spec;
  spec.modes.resize(1);
  spec.modes[0].kind = ModeKind::kIsosurface;
  spec.modes[0].of = "ball";
  spec.modes[0].solid = Solid::kBelow;
  spec.modes[0].strength = 20.0;
  spec.modes[0].friction = 0.3;
  if (motion != nullptr) spec.motions["ball"] = motion;
  return {makeScene(spec, {{"ball", ball}}, {kMotionStiffness, 0.0})};
}

void run(Felt& of) {
  const Vec3 d = Vec3(0.3, -0.9, 0.4).normalized();
  for (int i = 0; i < kTicks; ++i) {
    const double depth = std::min(6.0, of.state->time() / kMotionTick * 0.1 - 10.0);
    const Vec3 hand = kVoxel * (kCentre + (kRadius - depth) * d);
    const auto begin = Clock::now();
    const StepReport r = hapticStep(*of.scene, *of.reader, {hand}, *of.state, kMotionTick);
    const auto end = Clock::now();
    if (!(r.wanted.norm() > 0.0)) continue;
    of.times.push_back(std::chrono::duration<double, std::nano>(end - begin).count());
    of.readings += r.samples;
  }
}

void print(const char* name, std::vector<double>& ns, double readings) {
  std::printf("%-28s %8zu %8.0f %8.0f %8.0f %8.2f\n", name, ns.size(), percentile(ns, 0.5),
              percentile(ns, 0.99), percentile(ns, 0.999), readings);
}

void measure(int turns) {
  const FieldPtr ball = sphereMotion("level set", kRadius, 2.56).field;
  const WarpPtr warp = breathing();
  const FieldPtr flow = vectorGrid(Vec3::Constant(100.0), [](const Vec3& p) {
    return Vec3(std::sin(0.1 * p.y()), std::cos(0.1 * p.z()), std::sin(0.1 * p.x()));
  });
  std::map<std::string, Felt> all;
  all["at rest"] = felt(ball, nullptr);
  all["moved by keyframes"] = felt(ball, shaking());
  all["deformed"] = felt(ball, std::make_shared<const Motion>(warp));
  std::vector<double> of_warp;
  std::vector<double> of_vector;
  FieldCache cache;
  const VectorField& vectors = *std::get<1>(flow);
  vectors.reset(cache);
  double sum = 0.0;
  for (int turn = 0; turn < turns; ++turn) {
    for (auto& [name, one] : all) run(one);
    constexpr int kReads = 1000;
    const auto path = [](int i) {
      return Vec3(kVoxel * (kCentre + 0.02 * i * Vec3(0.6, 0.64, 0.48)));
    };
    const auto time = [&](std::vector<double>& to, const auto& read) {
      const auto begin = Clock::now();
      for (int i = 0; i < kReads; ++i) sum += read(i);
      to.push_back(std::chrono::duration<double, std::nano>(Clock::now() - begin).count() / kReads);
    };
    time(of_warp, [&](int i) { return warp->at(path(i), 1e-3 * i).shift.x(); });
    time(of_vector, [&](int i) { return vectors.sample(path(i), cache).value.x(); });
  }
  std::printf("%-28s %8s %8s %8s %8s %8s\n", "ns", "", "p50", "p99", "p99.9", "readings");
  for (auto& [name, one] : all) {
    const auto count = static_cast<double>(one.times.size());
    print(("a tick, " + name).c_str(), one.times, one.readings / count);
  }
  print("a reading of a warp", of_warp, 1.0);
  print("a reading of a vector grid", of_vector, 1.0);
  if (!std::isfinite(sum)) std::printf("not finite\n");
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("What a volume that deforms costs a tick");
  int turns = 200;
  app.add_option("--turns", turns, "Of 400 ticks each")->check(CLI::PositiveNumber);
  CLI11_PARSE(app, argc, argv);
  try {
    std::printf("# %s\n", describe(takeMachine()).c_str());
    measure(turns);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "palpate_bench_warp: %s\n", error.what());
    return 2;
  }
  return 0;
}
