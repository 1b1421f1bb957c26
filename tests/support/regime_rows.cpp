#include "tests/support/regime_rows.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include <Eigen/Geometry>

#include "palpate/bench/methods/constraint_approach.h"
#include "palpate/bench/methods/force_function.h"
#include "palpate/bench/methods/map_methods.h"
#include "palpate/devices/simulated/stability.h"
#include "palpate/devices/simulated/stability_map.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/buzz.h"
#include "tests/support/contenders.h"
#include "tests/support/formula_fields.h"
#include "tests/support/motion_problems.h"
#include "tests/support/passivity_runs.h"
#include "tests/support/problems.h"
#include "tests/support/random.h"
#include "tests/support/reference_solver.h"
#include "tests/support/scenes.h"

namespace palpate::bench {

namespace {

using test::Random;

constexpr double kStiffness = 500.0;  // [N/m]
constexpr double kTick = 1e-3;        // [s]
constexpr double kPeak = 8.0;         // [N]
constexpr double kSlew = 2000.0;      // [N/s]

void keepMost(double& most, double value) {
  most = std::max(most, value);
}

Vec3 turned(const Vec3& v, const Vec3& axis, double degrees) {
  return Eigen::AngleAxisd(degrees * M_PI / 180.0, axis) * v;
}

Primitive plane(const Vec3& at, const Vec3& normal, double strength) {
  return {PrimitiveKind::kPlane, at, normal, strength};
}

const Contender& named(const std::vector<Contender>& all, const std::string& method,
                       const std::string& setting) {
  return *std::find_if(all.begin(), all.end(), [&](const Contender& c) {
    return c.method == method && c.setting == setting;
  });
}

constexpr double kRadius = test::kBallRadius;

}  // namespace

Regime weakConstraints() {
  constexpr double kWeak = 1e-3;  // [N]
  constexpr double kAway = 5e-3;  // [m]
  Random random(2);
  double spurious = std::numeric_limits<double>::infinity();
  double ours = 0.0;
  double off = 0.0;
  for (const double degrees : {60.0, 45.0, 30.0, 10.0, 3.0, 1.0}) {
    double most = 0.0;
    for (int i = 0; i < 200; ++i) {
      const Vec3 proxy = random.inCube(1e-2);
      const Vec3 probe = proxy + kAway * random.direction();
      const Vec3 one = random.direction();
      const Vec3 two = turned(one, one.unitOrthogonal(), degrees);
      const std::array constraints{methods::Constraint{one, kWeak},
                                   methods::Constraint{two, kWeak}};
      const std::vector<Primitive> planes{plane(proxy, one, kWeak), plane(proxy, two, kWeak)};
      keepMost(
          most,
          kStiffness *
              (methods::constraintProxy(probe, proxy, kStiffness, constraints) - probe).norm());
      const SolveResult solved = solveProxy(probe, kStiffness, planes, proxy);
      const test::Reference reference = test::solveReference(probe, kStiffness, planes);
      keepMost(ours, kStiffness * solved.offset.norm() / (2.0 * kWeak));
      keepMost(off, kStiffness * (solved.offset - reference.offset).norm() / (2.0 * kWeak));
    }
    spurious = std::min(spurious, most);
  }
  const auto grown = [](std::size_t parallel) {
    const std::vector<methods::Constraint> constraints(parallel, {Vec3::UnitX(), 0.0});
    Vec3 proxy(1e-3, 0, 0);
    for (int tick = 0; tick < 10; ++tick) {
      proxy = methods::constraintProxy(Vec3::Zero(), proxy, kStiffness, constraints);
    }
    return proxy.norm() / 1e-3;
  };
  return {"constraints of 1 mN, 60 to 1 degrees apart, the hand 5 mm off",
          {{"constraint approach", "largest force of two, at the angle where it is smallest [N]",
            spurious, 1.0},
           {"constraint approach", "2 in parallel: error after 10 ticks, divided by the first",
            grown(2), 0.999},
           {"constraint approach", "3 in parallel: error after 10 ticks, divided by the first",
            grown(3), 1000.0}},
          {{"palpate", "largest force, divided by the sum of strengths", ours, 1.0 + 1e-6},
           {"palpate", "largest force error, divided by the sum of strengths", off, 1e-5}}};
}

Regime acuteWalls() {
  // A resting hand in troughs, in a slot and in a corner. Each method starts at its previous proxy.
  std::vector<BalanceProblem> problems;
  const auto add = [&](const Vec3& probe, std::vector<Primitive> planes) {
    problems.push_back({probe, kStiffness, Vec3(0, 0, 1e-3), std::move(planes)});
  };
  for (const double degrees : {1.0, 3.0, 10.0, 20.0, 30.0}) {
    add({2e-4, 0, -1.5e-3}, troughContact(degrees, 3.0).primitives);
  }
  add({3e-4, 0, 4e-4}, {plane({0, 0, 0}, {0, 0, 1}, 3.0), plane({0, 0, 1e-5}, {0, 0, -1}, 3.0)});
  std::vector<Primitive> corner;
  corner.reserve(3);
  for (int i = 0; i < 3; ++i) {
    corner.push_back(plane(Vec3::Zero(), turned({0.6, 0, 0.8}, Vec3::UnitZ(), 120.0 * i), 3.0));
  }
  add({1e-4, 2e-4, -1e-3}, corner);

  const std::vector<Contender> all = makeContenders(false);
  struct Came {
    double off = 0.0;      ///< Distance from the reference [m].
    double chatter = 0.0;  ///< Largest motion from tick to tick [m].
    double beyond = -1.0;  ///< Largest excess of the error over the error bound [m].
  };
  const auto rest = [&](const std::string& method, const std::string& setting) {
    constexpr int kTicks = 100;
    constexpr int kSettled = 50;
    const Contender& contender = named(all, method, setting);
    Came came;
    for (BalanceProblem p : problems) {
      const test::Reference reference = test::solveReference(p.probe, p.stiffness, p.primitives);
      contender.forget();
      for (int i = 0; i < kTicks; ++i) {
        const Answer answer = contender.solve(p, p.primitives);
        const Vec3 proxy = p.probe + answer.balance.offset;
        const double off = (answer.balance.offset - reference.offset).norm();
        keepMost(came.off, off);
        keepMost(came.beyond, off - answer.bound - reference.error_bound);
        if (i >= kSettled) keepMost(came.chatter, (proxy - p.start).norm());
        p.start = proxy;
      }
    }
    return came;
  };
  const Came constraint = rest("constraint approach", "");
  const Came fixed = rest("Euler, fixed step", "1e-2");
  const Came paper = rest(kPaper, "3e-5");
  const Came ours = rest(kOurs, "1e-6");
  // Random problems. In some of them, the smallest |f_res| is not at the balance.
  Random random(3);
  double misled = 0.0;
  double unlike = 0.0;
  for (int i = 0; i < 60; ++i) {
    BalanceProblem p = makeProblem(Family::kPlanes, 8, random);
    const test::Reference reference = test::solveReference(p.probe, p.stiffness, p.primitives);
    const Answer smallest = named(all, "smallest residual", "1e-5").solve(p, p.primitives);
    keepMost(misled, (smallest.balance.offset - reference.offset).norm());
    for (int start = 0; start < 10; ++start) {
      p.start = random.inCube(1e-2);
      const Answer answer = named(all, kOurs, "1e-8").solve(p, p.primitives);
      keepMost(unlike, (answer.balance.offset - reference.offset).norm());
    }
  }
  return {
      "planes 1 to 30 degrees apart, a slot, a corner, a hand at rest",
      {{"constraint approach", "largest distance from the balance [m]", constraint.off, 1e-3},
       {"Euler, fixed step", "chatter [m]", fixed.chatter, 1e-6},
       {kPaper, "largest distance from the balance [m]", paper.off, 1e-6},
       {"smallest residual", "eight planes: largest distance from the balance [m]", misled, 5e-4}},
      {{"palpate", "chatter [m]", ours.chatter, 1e-6},
       {"palpate", "largest excess of the error over the error bound [m]", ours.beyond, 0.0},
       {"palpate", "eight planes, random starts: largest distance from the balance [m]", unlike,
        1e-6}}};
}

Regime extremeSprings() {
  const std::vector<Contender> all = makeContenders(false);
  Random random(4);
  int fixed = 0;
  int ours = 0;
  double uncertain = 0.0;
  double off = 0.0;
  std::vector<int> simplex;
  for (const double reach : {1e-6, 1e-4, 1e-2, 1.0}) {
    for (const double stiffness : {1.0, 100.0, 1e4, 1e5}) {
      for (int i = 0; i < 8; ++i) {
        BalanceProblem p;
        p.stiffness = stiffness;
        p.probe = random.inCube(2.0 * reach);
        p.start = random.inCube(2.0 * reach);
        for (int j = 0; j < 3; ++j) {
          p.primitives.push_back(random.primitive());
          p.primitives.back().position = random.inCube(reach);
          p.primitives.back().strength = reach * stiffness * random.uniform(0.1, 1.0);
        }
        p.primitives[0].kind = PrimitiveKind::kPlane;
        fixed = std::max(
            fixed,
            named(all, "Euler, fixed step", "1e-3").solve(p, p.primitives).balance.iterations);
        simplex.push_back(
            named(all, "Nelder-Mead", "1e-5").solve(p, p.primitives).balance.iterations);
        const Answer answer = named(all, kOurs, "1e-6").solve(p, p.primitives);
        const test::Reference reference = test::solveReference(p.probe, p.stiffness, p.primitives);
        ours = std::max(ours, answer.balance.iterations);
        keepMost(uncertain, answer.bound / reachOf(p));
        keepMost(off, (answer.balance.offset - reference.offset).norm() / reachOf(p));
      }
    }
  }
  std::nth_element(simplex.begin(), simplex.begin() + static_cast<long>(simplex.size() / 2),
                   simplex.end());
  return {
      "s/k from 1e-6 to 1 m, k from 1 to 1e5 N/m",
      {{"Euler, fixed step", "largest number of evaluations", static_cast<double>(fixed), 20000.0},
       {"Nelder-Mead", "median number of evaluations",
        static_cast<double>(simplex[simplex.size() / 2]), 150.0}},
      {{"palpate", "largest number of iterations", static_cast<double>(ours), 60.0},
       {"palpate", "largest error bound [S/k]", uncertain, 1e-6},
       {"palpate", "largest distance from the reference [S/k]", off, 1e-6}}};
}

Regime strikesAndJumps() {
  const Shell shell = makeShell("level set", 1.5);
  const auto& field = std::get<std::shared_ptr<const ScalarField>>(shell.field);
  constexpr long kStrikes = 1000;
  constexpr double kSpeed = 2.0;   // [m/s]
  constexpr double kBehind = 3.6;  // [voxels]; below the outer surface
  // Strikes as in pressShell(), but reads values only where ticks end.
  Probed probed(field);
  Random random(11);
  long missed = 0;
  for (long i = 0; i < kStrikes; ++i) {
    const Vec3 d = random.direction();
    const Vec3 end = shell.centre + (shell.radius + shell.half - kBehind) * d;
    const double phase = random.uniform();
    bool seen = false;
    for (int k = 0; k <= 8; ++k) {
      const double before = std::max(8 - k - phase, 0.0) * voxelsPerTick(kSpeed);
      seen = seen || probed.value(end + before * d) < shell.level;
    }
    missed += seen ? 0 : 1;
  }
  const ShellResult pressed = pressShell(shell, 0.0, 0.6, kStrikes, {});

  // The hand moves into a ball while the device reports no positions.
  double spring = 0.0;
  double sent = 0.0;
  double most = 0.0;
  const FieldPtr ball = test::ballField();
  for (const double lost : {0.01, 0.02, 0.05, 0.1}) {
    const auto scene = test::ballScene(ball, 1e4, {kStiffness, 0.0});
    Reader reader;
    ProxyState state(ForceLimits{kPeak, kSlew});
    const double depth = std::min(0.25 * lost, 0.9 * kRadius);
    Vec3 wanted_before = Vec3::Zero();
    Vec3 sent_before = Vec3::Zero();
    for (int i = 0; i < 100; ++i) {
      const Vec3 hand(0, 0, i < 50 ? kRadius + 1e-4 : kRadius - depth);
      const StepReport r = hapticStep(*scene, reader, {hand}, state, kTick);
      keepMost(spring, (r.wanted - wanted_before).norm());
      keepMost(sent, (r.force - sent_before).norm());
      keepMost(most, r.force.norm());
      wanted_before = r.wanted;
      sent_before = r.force;
    }
  }
  return {
      "2 m/s on a shell of 1.5 voxels; positions lost for 10 to 100 ms",
      {{"contact checked only where ticks end", "strikes that go through, of 1,000",
        static_cast<double>(missed), 100.0},
       {"this engine without its limiter", "largest change of the force in a tick [N]", spring,
        5.0}},
      {{"palpate", "strikes that go through or yield, of 1,000",
        static_cast<double>(pressed.crossed + pressed.yielded), 0.0},
       {"palpate", "largest change of the force in a tick [N]", sent, kSlew * kTick * (1 + 1e-9)},
       {"palpate", "largest force [N]", most, kPeak * (1 + 1e-9)}}};
}

Regime steepAndNoisy() {
  // A fog with 1 % noise. Its ramp is 4 voxels wide on one side, and a third of that on the
  // opposite side.
  constexpr double kBall = 50.0;  // [voxels]
  constexpr int kSize = 112;
  Random random(5);
  const Vec3 centre = Vec3::Constant(0.5 * (kSize - 1));
  const FieldPtr fog = scalarGrid(
      kSize,
      [&](const Vec3& p) {
        const Vec3 d = p - centre;
        const double steep = d.x() > 0.0 ? 3.0 : 1.0;
        return std::clamp(500.0 + 250.0 * steep * (kBall - d.norm()), 0.0, 1000.0) +
               random.uniform(-10.0, 10.0);
      },
      "trilinear", false);
  const auto& field = std::get<std::shared_ptr<const ScalarField>>(fog);
  double loud = 0.0;
  double quiet = 0.0;
  for (const Buzzes& b : feelBuzz(field, {500.0, true, 0.05, 0.0, 2e-3, 3, 0.02, BuzzHand::kLed})) {
    keepMost(loud, std::sqrt(b.polynomial.power) / b.polynomial.force);
    keepMost(quiet, std::sqrt(b.engine.power) / b.engine.force);
  }
  // Swing of a hand that presses on a wall.
  const MapSetting setting;
  const MapContact wall = wallContact();
  const auto methods = methodsOver(wall);
  const auto swing = [&](const std::string& name) {
    const auto method = std::find_if(methods.begin(), methods.end(),
                                     [&](const MapMethod& m) { return m.name == name; });
    return tryCoupling(setting, wall, method->make(kStiffness, 0.0, kTick)).swing;
  };
  // Energy that a tick creates: by the constraint approach, then by the engine.
  double made = 0.0;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 proxy = random.inCube(5e-3);
    const Vec3 probe = proxy + random.inCube(3e-3);
    std::array<methods::Constraint, 3> constraints;
    for (auto& c : constraints) c = {random.direction(), random.uniform(0.0, 1.0)};
    const Vec3 next = methods::constraintProxy(probe, proxy, kStiffness, constraints);
    keepMost(made,
             0.5 * kStiffness * ((next - probe).squaredNorm() - (proxy - probe).squaredNorm()));
  }
  double injected = 0.0;
  GraphSpec spec = test::ballSpec(1.0);
  spec.modes[0].kind = ModeKind::kSurface;
  spec.modes.resize(3, spec.modes[0]);
  spec.modes[1].kind = ModeKind::kViscosity;
  spec.modes[1].strength = 0.5;
  spec.modes[2].kind = ModeKind::kFollow;
  spec.modes[2].of = "flow";
  const auto scene = makeScene(spec, {{"ball", makeSphere(Vec3::Zero(), 0.05)},
                                      {"flow", makeVortex(Vec3::Zero(), {1, 2, 3}, 0.2, 1.0)}});
  Reader reader;
  ProxyState state(ForceLimits{100.0, 1e9});
  const Vec3 about(0.05, 0, 0);
  Vec3 hand = about;
  for (int i = 0; i < 20000; ++i) {
    hand += 4e-4 * random.inCube(1.0) - 1e-3 * (hand - about);
    keepMost(injected, hapticStep(*scene, reader, {hand}, state, kTick).injected);
  }
  return {"values steep on one side, with noise; a wall; random directions",
          {{"force function, polynomial", "RMS force above 100 Hz, divided by the mean force", loud,
            0.02},
           {"force function", "swing of a hand at a wall [m]", swing("force function"), 1e-4},
           {"constraint approach", "largest energy that a tick creates [J]", made, 1e-3}},
          {{"palpate", "RMS force above 100 Hz, divided by the mean force", quiet, 1e-2},
           {"palpate", "swing of a hand at a wall [m]", swing(kOurs), 2.5e-5},
           {"palpate", "anchored modes: largest energy that a tick creates [J]", injected, 1e-12}}};
}

Regime stiffAndLate() {
  const MapSetting setting;
  const MapContact wall = wallContact();
  const double past = 1.3 * stableStiffness(setting.arm, setting.grip, setting.rate);
  long swinging = 0;
  for (const MapMethod& method : methodsOver(wall)) {
    const MapCell cell = tryCoupling(setting, wall, method.make(past, 0.0, kTick));
    swinging += cell.outcome != MapOutcome::kRests ? 1 : 0;
  }
  constexpr std::uint64_t kRuns = 150;
  const auto tally = [](Keeper keeper) {
    PassivityTally sum;
    Random random(6);
    for (std::uint64_t i = 0; i < kRuns; ++i) {
      PassivityRun run = randomRun(1000000 + i, true);
      run.delay = random.uniform(0.0, 5e-3);
      run.encoder = random.logUniform(1e-6, 1e-4);
      sum.add(play(run, keeper));
    }
    return sum;
  };
  const PassivityTally nobody = tally(Keeper::kNobody);
  const PassivityTally observer = tally(Keeper::kObserver);
  const PassivityTally tank = tally(Keeper::kTank);
  const auto share = [](long count) {
    return static_cast<double>(count) / static_cast<double>(kRuns);
  };
  return {
      "1.3 times the largest stable stiffness; delays to 5 ms, encoder steps of 1 to 100 um",
      {{"all methods, including this engine's balance",
        "methods that oscillate at a wall, of seven", static_cast<double>(swinging), 7.0},
       {"no passivity controller", "share of runs that give the hand energy", share(nobody.active),
        0.25},
       {"no passivity controller", "largest energy that a hand gains [J]", -nobody.worst, 1e-3},
       {"observer and controller", "share of runs that give the hand energy",
        share(observer.active), 0.25},
       {"observer and controller", "largest energy that a hand gains [J]", -observer.worst, 1e-3}},
      {{"palpate", "share of runs in which the tank breaks its guarantee", share(tank.broken), 0.0},
       {"palpate", "largest debt of the tank [J]", tank.debt, 0.0}}};
}

Regime scenesThatChange() {
  const FieldPtr ball = test::ballField();
  // A ball appears suddenly around a hand, which is then 1 cm deep.
  const Vec3 inside(0, 0, kRadius - 0.01);
  // A force function sees the new surface as a plane above the hand.
  const std::array over{plane(Vec3(0, 0, kRadius), Vec3::UnitZ(), 3.0)};
  const double pushed =
      kStiffness * methods::forceFunction(inside, kStiffness, over, inside).offset.norm();
  test::TestDevice device;
  std::atomic<std::uint64_t> guard{0};
  HapticLoop loop(device, 1.0 / kTick, nullptr, 0.0, {nullptr, nullptr, &guard});
  TickTime time;
  double jolt = 0.0;
  const auto run = [&](int ticks) {
    for (int i = 0; i < ticks; ++i) {
      time.now += kTick;
      ++guard;
      loop.tick(time);
      keepMost(jolt, device.sent.norm());
    }
  };
  device.hand.position = inside;
  loop.publish(test::ballScene(makeSphere(Vec3(1, 0, 0), kRadius)));
  run(1000);
  loop.publish(test::ballScene(ball));
  run(1000);

  // A ball moves over a resting hand at 0.2 m/s.
  constexpr double kSpeed = 0.2;  // [m/s]
  constexpr double kFrom = 0.01;  // [m]; distance of the ball's surface from the hand at the start
  constexpr double kDeep = 4e-3;
  const Vec3 still(0, 0, kRadius + kFrom);
  const double seconds = (kFrom + kDeep) / kSpeed;
  GraphSpec spec = test::ballSpec(5.0);
  const std::array keys{Keyframe{0.0, {1, 0, 0, 0}, Vec3::Zero()},
                        Keyframe{seconds, {1, 0, 0, 0}, Vec3(0, 0, kFrom + kDeep)}};
  spec.motions["ball"] = std::make_shared<const Motion>(keys, false);
  const auto scene = makeScene(spec, {{"ball", ball}}, {kStiffness, 0.0});
  Reader reader;
  ProxyState state(ForceLimits{1e3, 1e12});
  double off = 0.0;
  double uncounted = 0.0;
  long ticks = 0;
  Reader reader_of_swaps;
  ProxyState uncarried(ForceLimits{1e3, 1e12});
  long lost = 0;
  long left = 0;
  Vec3 before = still;
  for (int i = 1; i <= 2 * static_cast<int>(seconds / kTick); ++i) {
    const StepReport r = hapticStep(*scene, reader, {still}, state, kTick);
    const Vec3 centre = state.bodies()[0].pose.translate;
    const double depth = kRadius - (still - centre).norm();
    // The same ball as a new scene in each tick, so its motion does not carry the proxy.
    const auto placed = test::ballScene(makeSphere(centre, kRadius), 5.0, {kStiffness, 0.0});
    const StepReport swapped = hapticStep(*placed, reader_of_swaps, {still}, uncarried, kTick);
    keepMost(uncounted,
             0.5 * kStiffness * ((r.proxy - still).squaredNorm() - (before - still).squaredNorm()) -
                 r.injected);
    before = r.proxy;
    if (depth <= 1e-4) continue;
    ++ticks;
    left += r.wanted.norm() > 0.0 ? 0 : 1;
    keepMost(off, std::abs((r.proxy - centre).norm() - kRadius) / 1e-3);
    lost += swapped.wanted.norm() > 0.0 ? 0 : 1;
  }
  return {"a ball that appears around the hand; a ball that moves over the hand",
          {{"force function", "force in the first tick [N]", pushed, 2.0},
           {"this engine, with a new scene every tick",
            "share of ticks behind the wall without a force",
            static_cast<double>(lost) / static_cast<double>(ticks), 0.9}},
          {{"palpate", "largest force before and after the ball appears [N]", jolt, 0.1},
           {"palpate", "share of ticks behind the wall without a force",
            static_cast<double>(left) / static_cast<double>(ticks), 0.0},
           {"palpate", "largest distance of the proxy from the moving surface [voxels]", off, 0.01},
           {"palpate", "largest energy of the spring that is not counted [J]", uncounted, 1e-12}}};
}

Regime brokenDevices() {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  Random random(8);
  test::TestDevice device;
  device.about.limits = {kPeak, kSlew};
  std::atomic<std::uint64_t> guard{0};
  HapticLoop loop(device, 1.0 / kTick, nullptr, 0.0, {nullptr, nullptr, &guard});
  loop.publish(test::ballScene(test::ballField(), 30.0));
  TickTime time;
  double worst_old = 0.0;
  long bad_old = 0;
  long bad = 0;
  long deep = 0;  // number of ticks with a deep hand
  long mute = 0;  // number of ticks with a deep hand and without force
  double most = 0.0;
  double steepest = 0.0;
  Vec3 sent = Vec3::Zero();
  Vec3 place(0, 0, 0.025);
  Vec3 velocity = Vec3::Zero();
  constexpr long kTicks = 400000;
  for (long i = 0; i < kTicks; ++i) {
    // The hand moves in and out, because after a fault the hand feels no force until it has been
    // outside.
    const Vec3 about(0, 0, kRadius + 6e-3 * std::sin(0.02 * static_cast<double>(i)));
    velocity += 0.02 * random.inCube(1.0) - 0.1 * velocity - 5.0 * (place - about);
    place += kTick * velocity;
    device.hand = {};
    device.hand.position = place;
    const int event = random.integer(20000);
    if (event == 0) device.hand.position.x() = nan;
    if (event == 1) device.hand.position = 1e-3 * random.direction();
    if (event == 2) device.hand.age = random.uniform(0.0, 1.0);
    if (event == 3) device.hand.fault = Fault::kGone;
    time.dt = event == 4 ? 0.02 : kTick;
    time.setLate(time.dt - kTick, kTick);
    time.now += time.dt;
    if (loop.latest().fault != Fault::kNone && random.integer(100) == 0) loop.clear();
    ++guard;
    loop.tick(time);
    // A penalty force k times the depth in the ball, sent to the motors without limits.
    const Vec3& hand = device.hand.position;
    const double r = hand.norm();
    const Vec3 old =
        kStiffness * (!(r >= kRadius) ? Vec3((kRadius / r - 1.0) * hand) : Vec3(Vec3::Zero()));
    if (!old.allFinite() || old.norm() > kPeak) ++bad_old;
    if (old.allFinite()) keepMost(worst_old, old.norm());
    if (!device.sent.allFinite()) ++bad;
    keepMost(most, device.sent.norm());
    mute += old.norm() > 0.5 && device.sent.norm() == 0.0 ? 1 : 0;
    deep += old.norm() > 0.5 ? 1 : 0;
    keepMost(steepest, (device.sent.norm() - sent.norm()) / (kSlew * time.dt));
    sent = device.sent;
  }
  return {
      "positions not finite, jumping, old or late; arm unplugged; 400,000 ticks",
      {{"penalty force, no limiter", "number of forces that are not finite or exceed the peak",
        static_cast<double>(bad_old), 10.0},
       {"penalty force, no limiter", "largest force [N]", worst_old, 1.5 * kPeak}},
      {{"palpate", "number of forces that are not finite", static_cast<double>(bad), 0.0},
       {"palpate", "largest force [N]", most, kPeak * (1 + 1e-9)},
       {"palpate", "largest growth of the force, divided by the slew limit", steepest, 1.0 + 1e-9},
       {"palpate", "share of ticks with the force cut while the hand is deep",
        static_cast<double>(mute) / static_cast<double>(deep), 0.1}}};
}

std::vector<Regime> allRegimes() {
  return {weakConstraints(), acuteWalls(),   extremeSprings(),   strikesAndJumps(),
          steepAndNoisy(),   stiffAndLate(), scenesThatChange(), brokenDevices()};
}

}  // namespace palpate::bench
