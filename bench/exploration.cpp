#include "bench/exploration.h"

#include <array>
#include <cmath>
#include <memory>
#include <utility>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/formula_fields.h"
#include "tests/support/random.h"

namespace palpate::bench {
namespace {

constexpr double kRate = 1000.0;  // [Hz]
constexpr double kRadius = 0.04;  // [m], radius of the ball
constexpr double kVoxel = 2e-3;   // [m]
constexpr double kTremor = 1e-4;  // [m], twice the amplitude of each of four waves

std::unique_ptr<const Scene> makeBall(Explored what) {
  ModeSpec surface;
  surface.kind = ModeKind::kIsosurface;
  surface.of = "ball";
  surface.solid = Solid::kBelow;
  surface.strength = 2.0;
  ModeSpec other;
  if (what == Explored::kSurfaceAndDrag) {
    other.kind = ModeKind::kViscosity;
    other.of = "ball";
    other.strength = 0.3;
  } else {
    other.kind = ModeKind::kFollow;
    other.of = "stream";
    other.strength = 0.7;
  }
  GraphSpec graph;
  graph.modes = {surface, other};
  return makeScene(graph,
                   {{"ball", makeSphere(Vec3::Zero(), kRadius, kVoxel)},
                    {"stream", makeVortex(Vec3::Zero(), {2.0, 4.0, 10.0}, 0.3, 0.1, kVoxel)}});
}

/// Returns the target of a hand that explores the ball's box along the scripted path, with a
/// tremor. The script runs at 0.4 to 3.6 times its normal speed.
HandTarget tremble(double seconds, std::uint64_t seed) {
  constexpr double kPace = 2.0;
  constexpr double kSway = 1.6;                    // amplitude of the pace
  constexpr double kSwayRate = 2.0 * M_PI / 11.0;  // [rad/s]
  const auto script = [](double t) {
    return kPace * t - kSway / kSwayRate * (1.0 - std::cos(kSwayRate * t));
  };
  const HandTarget steady =
      explore({Vec3::Constant(-kRadius), Vec3::Constant(kRadius)}, script(seconds));
  test::Random random(seed);
  struct Wave {
    Vec3 size;
    double rate, phase;  // [rad/s], [rad]
  };
  std::array<Wave, 4> waves;
  for (Wave& wave : waves) {
    wave.size = 0.5 * kTremor * random.direction();
    wave.rate = 2.0 * M_PI * random.uniform(8.0, 12.0);
    wave.phase = random.uniform(-M_PI, M_PI);
  }
  return {[=](double t) -> Vec3 {
            Vec3 p = steady.at(script(t));
            for (const Wave& wave : waves) p += wave.size * std::sin(wave.rate * t + wave.phase);
            return p;
          },
          seconds};
}

/// Returns the proxy's position when the primitives were placed: the anchor of the second mode, or
/// `before` if that mode has no primitive.
Vec3 startOf(std::span<const Primitive> primitives, const Vec3& before) {
  for (const Primitive& p : primitives) {
    if (p.kind == PrimitiveKind::kPoint || p.kind == PrimitiveKind::kLine) return p.position;
  }
  return before;
}

}  // namespace

std::vector<RecordedBalance> recordExploration(Explored what, double seconds, std::uint64_t seed) {
  const auto scene = makeBall(what);
  SimulatedDevice device({}, {}, tremble(seconds, seed), kRate);
  Reader reader;
  ProxyState state(device.info().limits);
  std::vector<RecordedBalance> recording;
  Vec3 before = device.read().position;
  while (!device.ended()) {
    const HandState hand = device.read();
    const StepReport report = hapticStep(*scene, reader, hand, state, 1.0 / kRate);
    const auto set = state.primitives().items();
    RecordedBalance tick;
    tick.problem = {hand.position, scene->coupling.stiffness, startOf(set, before),
                    std::vector<Primitive>(set.begin(), set.end())};
    tick.speed = device.velocity().norm();
    tick.first = recording.empty();
    recording.push_back(std::move(tick));
    before = report.proxy;
    device.write(report.force);
  }
  return recording;
}

std::vector<RecordedBalance> windowsOf(const std::vector<RecordedBalance>& recording,
                                       std::size_t count, std::size_t windows, std::size_t length) {
  std::vector<std::size_t> wanted;
  for (std::size_t i = 0; i < recording.size(); ++i) {
    if (recording[i].problem.primitives.size() == count) wanted.push_back(i);
  }
  std::vector<RecordedBalance> kept;
  std::size_t next = 0;  // index into `wanted` of the tick after the last kept one
  std::size_t last = 0;  // index into `recording` of the tick kept last
  for (std::size_t window = 0; window < windows; ++window) {
    std::size_t i = std::max(next, window * wanted.size() / windows);
    for (std::size_t n = 0; n < length && i < wanted.size(); ++n, ++i) {
      kept.push_back(recording[wanted[i]]);
      kept.back().first = kept.size() == 1 || wanted[i] != last + 1;
      last = wanted[i];
    }
    next = i;
  }
  return kept;
}

std::vector<RecordedBalance> recordWalks(Anchoring anchoring, int count, std::size_t walks,
                                         std::size_t ticks, std::uint64_t seed) {
  // In each tick the hand gets a random push, and a spring pulls it back.
  constexpr double kPush = 1e-5;  // [m], rms per axis
  constexpr double kDamping = 1e-3;
  constexpr double kPull = 2e-3;
  constexpr double kTurn = 1e-3;           // [rad], rms per axis
  constexpr std::size_t kApproach = 1000;  // ticks in which the walk widens; not recorded
  // Half the width of a uniform distribution with variance 1.
  const double unit = std::sqrt(3.0);

  test::Random random(seed);
  std::vector<RecordedBalance> recording;
  for (std::size_t walk = 0; walk < walks; ++walk) {
    RecordedBalance tick;
    BalanceProblem& now = tick.problem;
    for (int i = 0; i < count; ++i) {
      now.primitives.push_back(random.primitive());
      now.primitives.back().position.setZero();
      now.primitives.back().strength *= 2.0 / count;
    }
    Vec3 step = Vec3::Zero();
    for (std::size_t i = 0; i < kApproach + ticks; ++i) {
      step += kPush * random.inCube(unit) - kDamping * step - kPull * now.probe;
      now.probe += step;
      if (anchoring == Anchoring::kCarried) {
        for (Primitive& p : now.primitives) {
          p.position = now.start;
          p.direction = (p.direction + kTurn * random.inCube(unit)).normalized();
        }
      }
      tick.speed = kRate * step.norm();
      tick.first = i == kApproach;
      if (i >= kApproach) recording.push_back(tick);
      now.start = solveProxy(now.probe, now.stiffness, now.primitives, now.start).proxy;
    }
  }
  return recording;
}

}  // namespace palpate::bench
