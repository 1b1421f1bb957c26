#include "palpate/engine/balance/friction.h"

#include <cmath>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/counters.h"
#include "tests/support/formula_fields.h"
#include "tests/support/fresh_hand.h"
#include "tests/support/random.h"
#include "tests/support/reference_solver.h"

namespace palpate::friction_test {
using palpate::test::CountScope;
using palpate::test::Random;

namespace {

constexpr double kStiffness = 500.0;

/// Solves balances with friction. Each solve starts from the last balance (warm start), unless
/// restart() is called before.
struct Balance {
  PrimitiveSet set;
  WarmStart warm;
  FrictionStart start;
  std::vector<Vec3> forces{kMaxPrimitives, Vec3::Zero()};
  SolverParams params;

  SolveResult solve(const Vec3& probe, const Vec3& proxy = Vec3::Zero()) {
    return solveWithFriction(probe, kStiffness, set, proxy, params, warm, start, forces);
  }
  /// Forgets the last balance. This is faster than making a new Balance.
  void restart() {
    set.clear();
    warm.forget();
    start.forget();
  }
  [[nodiscard]] double load(const FrictionLink& link) const {
    return set.items()[link.plane].direction.dot(forces[link.plane]);
  }
  [[nodiscard]] double strength(const FrictionLink& link) const {
    return set.items()[link.line].strength;
  }
};

/// Returns a random unit vector perpendicular to q.
Vec3 across(const Vec3& q, Random& random) {
  return q.cross(random.direction()).normalized();
}

}  // namespace

TEST_CASE("slip starts at mu times the normal load of the same tick", "[modes][friction]") {
  Random random(61);
  test::FreshHand hand({100.0, 1e9});
  for (int i = 0; i < 1000; ++i) {
    const Vec3 q = random.direction();
    const Vec3 t = across(q, random);
    const double mu = random.uniform(0.05, 1.5);
    const double depth = random.uniform(1e-4, 3e-3);
    CAPTURE(i, q, mu, depth);
    // Random coordinates, because round numbers would hide rounding errors.
    const Vec3 corner = random.inCube(0.01);
    ModeSpec wall;
    wall.kind = i % 2 == 0 ? ModeKind::kIsosurface : ModeKind::kSurface;
    wall.of = "wall";
    wall.solid = Solid::kBelow;
    wall.strength = 10.0;
    wall.friction = mu;
    GraphSpec spec;
    spec.modes = {wall};
    const auto scene = makeScene(spec, {{"wall", makeHalfSpace(corner, q)}});
    const auto slipAt = [&](double share) {
      hand.restart();
      (void)hapticStep(*scene, hand.reader, {corner}, hand.state, 1e-3);
      const Vec3 probe = corner - depth * q + share * mu * depth * t;
      const StepReport report = hapticStep(*scene, hand.reader, {probe}, hand.state, 1e-3);
      CHECK(report.solver == SolverKind::kClosedForm);
      CHECK(report.injected <= 1e-12);
      return t.dot(report.proxy - corner);
    };
    const double rounding = 1e-15 * corner.norm();
    CHECK(std::abs(slipAt(1.0 - 1e-9)) <= rounding);
    CHECK(slipAt(1.0 + 1e-9) > 0.5e-9 * mu * depth - rounding);
    CHECK(slipAt(2.0) == Approx(mu * depth).epsilon(1e-9));
  }
}

TEST_CASE(
    "a plane with friction balances with drags at its contact point without the general solver",
    "[modes][friction]") {
  Random random(64);
  const long cases = test::cases(20000);
  int slipped = 0;
  int free = 0;
  int in_front = 0;
  Balance b;
  for (long i = 0; i < cases; ++i) {
    b.restart();
    const Vec3 q = random.direction();
    const Vec3 grip = random.inCube(1e-3);
    // In three of four cases the plane has moved since the proxy gripped it.
    const double height = i % 4 == 0 ? 0.0 : random.uniform(-2e-4, 2e-4);
    const double strength = random.uniform(0.5, 4.0);
    const double mu = random.uniform(0.0, 1.5);
    const Vec3 anchor = grip - height * q + 1e-3 * across(q, random);
    REQUIRE(b.set.tryAdd({PrimitiveKind::kPlane, anchor, q, strength}));
    REQUIRE(b.set.tryAddFriction(grip, mu));
    const double drag = random.uniform(0.01, 0.5);
    double drags = drag;
    REQUIRE(b.set.tryAdd({PrimitiveKind::kPoint, grip, Vec3::UnitX(), drag}));
    if (i % 3 == 0) {
      REQUIRE(b.set.tryAdd({PrimitiveKind::kPoint, grip, Vec3::UnitX(), 0.1}));
      drags += 0.1;
    }
    Vec3 push = Vec3::Zero();
    if (i % 5 == 0) {
      push = 0.3 * random.direction();
      REQUIRE(b.set.tryAdd({PrimitiveKind::kForce, {}, push.normalized(), 0.3}));
    }
    const Vec3 probe = grip + random.inCube(8e-3);
    const SolveResult result = b.solve(probe, grip);
    const std::vector<Primitive> items(b.set.items().begin(), b.set.items().end());
    CAPTURE(i, height, mu, test::describe(probe, kStiffness, items));
    // Skips planes whose load, with the drags, can exceed their strength: Newton's method solves
    // those cases. Drags that hold the proxy in front of the plane do not count.
    const double pressed = q.dot(anchor - probe) * kStiffness - q.dot(push);
    if (std::max(pressed, 0.0) + (height > 0.0 ? 0.0 : drags) > strength) continue;
    REQUIRE(result.status == SolveStatus::kConverged);
    REQUIRE(result.solver != SolverKind::kGeneral);
    REQUIRE(result.iterations <= 20);
    if (height < 0.0) REQUIRE(result.iterations == 0);
    REQUIRE(result.error_bound <= 1e-15);
    constexpr double kRounding = 1e-15;                        // [m]
    constexpr double kForce = 100.0 * kRounding * kStiffness;  // [N]

    Vec3 sum = -kStiffness * result.offset;
    for (std::size_t j = 0; j < items.size(); ++j) sum += b.forces[j];
    REQUIRE(sum.norm() <= kForce);
    const FrictionLink& link = b.set.links()[0];
    const double load = b.load(link);
    const double above = q.dot(result.proxy - anchor);
    REQUIRE(load >= 0.0);
    REQUIRE(load <= strength * (1.0 + 1e-15));
    if (load > kForce) REQUIRE(above <= kRounding);
    if (load < strength - kForce) REQUIRE(above >= -kRounding);
    // Checks Coulomb's law.
    const Vec3 went = result.proxy - grip;
    const Vec3 slip = went - q.dot(went) * q;
    const Vec3 friction = b.forces[link.line];
    REQUIRE(std::abs(b.strength(link) - mu * load) <= kForce);
    REQUIRE(friction.norm() <= mu * load + kForce);
    if (slip.norm() > 1e-9) {
      REQUIRE((friction + mu * load * slip.normalized()).norm() <= 1e-5 * mu * load + kForce);
    }
    // Checks the drags: each is within its strength. If the plane is pressed and has not moved back
    // from the proxy, the drags are on the plane.
    double work = friction.dot(went);
    for (std::size_t j = 0; j < items.size(); ++j) {
      if (items[j].kind != PrimitiveKind::kPoint) continue;
      const Vec3 from = result.proxy - items[j].position;
      const Vec3& force = b.forces[j];
      REQUIRE(force.norm() <= items[j].strength + kForce);
      if (from.norm() > 1e-9) {
        REQUIRE((force + items[j].strength * from.normalized()).norm() <= 1e-5);
      }
      if (load > kForce && height <= 0.0) {
        REQUIRE(std::abs(q.dot(items[j].position - anchor)) <= kRounding);
      }
      work += force.dot(went);
    }
    REQUIRE(work <= 1e-15);  // friction and drags add no energy

    const SolveResult plain = solveProxy(probe, kStiffness, items, grip);
    REQUIRE((result.offset - plain.offset).norm() <= result.error_bound + plain.error_bound);
    const SolveResult again = b.solve(probe, grip);
    REQUIRE((again.offset - result.offset).norm() <= kRounding);
    slipped += slip.norm() > 1e-9 ? 1 : 0;
    free += load <= 0.0 ? 1 : 0;
    in_front += result.iterations > 0 ? 1 : 0;
  }
  CHECK(slipped > cases / 10);
  CHECK(free > cases / 10);
  CHECK(in_front > cases / 10);
}

TEST_CASE("on one plane with a drag the spring changes by at most 1 + mu times the hand's motion",
          "[modes][friction]") {
  Random random(65);
  const long cases = test::cases(300);
  Balance b;
  for (long i = 0; i < cases; ++i) {
    const Vec3 q = random.direction();
    const double mu = random.uniform(0.1, 1.5);
    const Vec3 way = random.inCube(2e-6);
    Vec3 probe = random.inCube(3e-3);
    // The plane is up to 20 um away from the old proxy. On a round surface this happens because the
    // plane is read at the new proxy.
    const double height = random.uniform(-2e-5, 2e-5);
    const auto offset = [&] {
      b.restart();
      REQUIRE(b.set.tryAdd({PrimitiveKind::kPlane, -height * q, q, 4.0}));
      REQUIRE(b.set.tryAddFriction(Vec3::Zero(), mu));
      REQUIRE(b.set.tryAdd({PrimitiveKind::kPoint, Vec3::Zero(), Vec3::UnitX(), 0.3}));
      return b.solve(probe).offset;
    };
    Vec3 last = offset();
    for (int tick = 0; tick < 1000; ++tick) {
      probe += way;
      const Vec3 now = offset();
      CAPTURE(i, tick, mu, height);
      REQUIRE((now - last).norm() <= (1.0 + mu) * way.norm());
      last = now;
    }
  }
}

TEST_CASE("behind a surface that yields a drag holds the proxy in place", "[modes][friction]") {
  // The body has a skin that yields at 0.8 N, and a drag of 0.3 N inside. The hand moves between
  // depths of 3.2 mm and 2.4 mm five times.
  ModeSpec skin;
  skin.kind = ModeKind::kIsosurface;
  skin.of = "body";
  skin.solid = Solid::kBelow;
  skin.strength = 0.8;
  skin.friction = 0.2;
  ModeSpec tissue;
  tissue.kind = ModeKind::kViscosity;
  tissue.of = "body";
  tissue.strength = 0.3;
  GraphSpec spec;
  spec.modes = {skin, tissue};
  const auto scene =
      makeScene(spec, {{"body", makeHalfSpace(Vec3::Zero(), Vec3::UnitZ(), 1e-3)}}, {500.0, 0.0});
  Reader reader;
  ProxyState state(ForceLimits{1000.0, 1e9});
  double at = 1e-3;
  double injected = 0.0;
  StepReport report;
  const auto go = [&](double to, int ticks) {
    const double from = at;
    for (int i = 1; i <= ticks; ++i) {
      at = from + (to - from) * i / ticks;
      report = hapticStep(*scene, reader, {Vec3(0.0, 0.0, at)}, state, 1e-3);
      injected += report.injected;
    }
  };
  go(-3.2e-3, 400);
  for (int stroke = 0; stroke < 5; ++stroke) {
    CHECK(report.proxy.z() == Approx(-1e-3));
    CHECK(report.wanted.z() == Approx(1.1));
    go(-2.4e-3, 100);
    CHECK(report.proxy.z() == Approx(-1e-3));
    CHECK(report.wanted.z() == Approx(0.7));
    go(-3.2e-3, 100);
  }
  CHECK(injected < 1e-12);
  for (const double depth : {1.2e-3, 1.7e-3, 2.2e-3, 2.6e-3}) {
    go(-depth, 50);
    go(-depth, 10);
    const Vec3 rests = report.proxy;
    go(-depth, 50);
    CHECK((report.proxy - rests).norm() <= 1e-12);
  }
}

TEST_CASE("Coulomb's law holds for a plane that is balanced together with other primitives",
          "[modes][friction]") {
  Random random(62);
  const long cases = test::cases(20000);
  long iterations = 0;
  int worst = 0;
  Balance b;
  for (long i = 0; i < cases; ++i) {
    b.restart();
    const Vec3 q = random.direction();
    const double strength = random.uniform(0.5, 4.0);
    REQUIRE(b.set.tryAdd({PrimitiveKind::kPlane, Vec3::Zero(), q, strength}));
    const double mu = random.uniform(0.0, 1.0);
    REQUIRE(b.set.tryAddFriction(Vec3::Zero(), mu));
    for (int j = 0; j < 2; ++j) {
      Primitive other = random.primitive();
      if (i % 2 == 0) other.position.setZero();
      REQUIRE(b.set.tryAdd(other));
    }
    const Vec3 probe = random.inCube(5e-3);
    const SolveResult result = b.solve(probe);
    CAPTURE(i, mu, strength, probe);
    CAPTURE(test::describe(probe, kStiffness, {b.set.items().begin(), b.set.items().end()}));
    REQUIRE(result.status == SolveStatus::kConverged);
    REQUIRE(result.error_bound <= 1e-6);
    const FrictionLink& link = b.set.links()[0];
    REQUIRE(std::abs(b.strength(link) - mu * b.load(link)) <= 1e-9 * strength);
    // Fixed primitives with the final strengths of the friction must give the same balance, within
    // the error bounds.
    const SolveResult plain = solveProxy(probe, kStiffness, b.set.items(), Vec3::Zero());
    REQUIRE((result.offset - plain.offset).norm() <= result.error_bound + plain.error_bound);
    if (i % 100 == 0) {
      const test::Reference reference = test::solveReference(probe, kStiffness, b.set.items());
      REQUIRE((result.offset - reference.offset).norm() <=
              result.error_bound + reference.error_bound);
    }
    iterations += result.iterations;
    worst = std::max(worst, result.iterations);
  }
  CAPTURE(worst);
  CHECK(iterations / cases <= 15);
  CHECK(worst <= 2 * SolverParams{}.max_iterations);
}

TEST_CASE(
    "several planes with friction each obey Coulomb's law or the error bound covers the excess",
    "[modes][friction]") {
  Random random(63);
  const long cases = test::cases(5000);
  int limited = 0;
  Balance b;
  for (long i = 0; i < cases; ++i) {
    b.restart();
    const int planes = 2 + random.integer(2);
    for (int j = 0; j < planes; ++j) {
      REQUIRE(b.set.tryAdd(
          {PrimitiveKind::kPlane, Vec3::Zero(), random.direction(), random.uniform(0.5, 3.0)}));
      REQUIRE(b.set.tryAddFriction(Vec3::Zero(), random.uniform(0.0, 0.6)));
    }
    const SolveResult result = b.solve(random.inCube(5e-3));
    REQUIRE(result.status != SolveStatus::kBadInput);
    double excess = 0.0;
    for (const FrictionLink& link : b.set.links()) {
      excess += std::abs(b.strength(link) - link.coefficient * b.load(link));
    }
    // Either Coulomb's law holds, or the error bound covers the excess.
    if (result.status == SolveStatus::kConverged) {
      REQUIRE(excess <= 1e-8);
    } else {
      REQUIRE(result.error_bound >= excess / kStiffness);
      ++limited;
    }
  }
  CAPTURE(limited);
  CHECK(limited <= 1e-3 * static_cast<double>(cases));
}

TEST_CASE("if the search for frictions ends early none falls below its last strength or its limit",
          "[modes][friction]") {
  // The hand jumps between random positions within two to four walls.
  Random random(64);
  const long cases = test::cases(3000);
  long limited = 0;
  long stopped = 0;
  long weaker = 0;  // number of frictions with the least strength that this test allows
  Balance b;
  for (long i = 0; i < cases; ++i) {
    b.restart();
    const int planes = 2 + random.integer(3);
    for (int j = 0; j < planes; ++j) {
      REQUIRE(b.set.tryAdd(
          {PrimitiveKind::kPlane, Vec3::Zero(), random.direction(), random.uniform(0.5, 3.0)}));
      REQUIRE(b.set.tryAddFriction(Vec3::Zero(), random.uniform(0.8, 1.5)));
    }
    for (int at = 0; at < 5; ++at) {
      const std::vector<double> held = b.start.held;
      const bool remembered = b.start.count > 0;
      const Vec3 probe = random.inCube(5e-3);
      // Every second solve has a limit of six iterations, so that it often ends early.
      b.params.max_iterations = at % 2 == 0 ? SolverParams{}.max_iterations : 6;
      const SolveResult result = b.solve(probe);
      if (result.status != SolveStatus::kIterationLimit) continue;
      const auto links = b.set.links();
      double excess = 0.0;
      for (const FrictionLink& link : links) {
        excess += std::abs(b.strength(link) - link.coefficient * b.load(link));
      }
      REQUIRE(result.error_bound >= excess / kStiffness);
      ++(at % 2 == 0 ? limited : stopped);
      // If Coulomb's law is violated, each friction must have at least the strength of the last
      // balance, or the largest strength that its plane allows.
      for (std::size_t l = 0; remembered && excess > 1e-9 && l < links.size(); ++l) {
        const double most = links[l].coefficient * b.set.items()[links[l].plane].strength;
        CAPTURE(i, at, l, held[l], most);
        REQUIRE(b.strength(links[l]) >= std::min(held[l], most));
        if (b.strength(links[l]) == std::min(held[l], most)) ++weaker;
      }
    }
  }
  CAPTURE(limited, stopped, weaker);
  CHECK(limited <= cases / 10000);  // each case has three solves with the normal limit
  CHECK(stopped > cases / 10);
  CHECK(weaker > cases / 10);
}

TEST_CASE("the solver finds the next balance where a branch of balances ends at a fold",
          "[modes][friction]") {
  // Each of the two recorded ticks has a wall with friction, a cloud's plane, and a mist's line.
  // The branch of balances ends at a fold.
  struct Tick {
    double stiffness;
    Vec3 probe;
    Vec3 proxy;
    Primitive wall;
    Primitive cloud;
    Primitive mist;
  };
  const std::vector<Tick> ticks{
      {
          459.54721208174919,
          {0.027060000000000001, 0.0090200000000000002, -0.00018000000000000001},
          {0.030508491140714352, 0.012556329679646637, -0.00032295779869613502},
          {PrimitiveKind::kPlane,
           {0.030508793543103582, 0.01255559129548273, -0.00032296364030728479},
           Vec3(0.92475014006085288, 0.3804489954628108, -0.0097846976841971245).normalized(),
           3},
          {PrimitiveKind::kPlane,
           {0.030508491140714352, 0.012556329679646637, -0.00032295779869613502},
           Vec3(0.73878633891205148, 0.56175073866848146, -0.37233164389068923).normalized(),
           0.16182189569347427},
          {PrimitiveKind::kLine,
           {0.030508491140714352, 0.012556329679646637, -0.00032295779869613502},
           Vec3(-0.73877359931302478, -0.56176893542281559, 0.37232946720880794).normalized(),
           0.080910947846737136},
      },
      {
          459.19806621244118,
          {0.026900000000000004, 0.0087500000000000008, -0.00050000000000000001},
          {0.030563956413005539, 0.012420461400550835, -0.000332964036650704},
          {PrimitiveKind::kPlane,
           {0.030563955894024115, 0.012420461109545786, -0.0003329640434520687},
           Vec3(0.92642160917023086, 0.37635254876710966, -0.010087670639967582).normalized(),
           3},
          {PrimitiveKind::kPlane,
           {0.030563956413005539, 0.012420461400550835, -0.000332964036650704},
           Vec3(0.74228821256613953, 0.55647251356961913, -0.37329150958316165).normalized(),
           0.16320017397493683},
          {PrimitiveKind::kLine,
           {0.030563956413005539, 0.012420461400550835, -0.000332964036650704},
           Vec3(-0.74229898147062279, -0.55645485384404303, 0.37329642074507069).normalized(),
           0.081600086987468415},
      },
  };
  for (const Tick& tick : ticks) {
    PrimitiveSet set;
    REQUIRE(set.tryAdd(tick.wall));
    REQUIRE(set.tryAddFriction(tick.proxy, 0.4));
    REQUIRE(set.tryAdd(tick.cloud));
    REQUIRE(set.tryAdd(tick.mist));
    WarmStart warm;
    FrictionStart start;
    std::vector<Vec3> forces(kMaxPrimitives, Vec3::Zero());
    const SolveResult r =
        solveWithFriction(tick.probe, tick.stiffness, set, tick.proxy, {}, warm, start, forces);
    CHECK(r.status == SolveStatus::kConverged);
    CHECK(r.error_bound <= 1e-6);
    CHECK(r.iterations <= 60);
  }
}

TEST_CASE("a converged tick at a yielding skin over bone has an error bound of at most 3 um",
          "[modes][friction][release]") {
  // The hand presses through a skin that yields and a tissue with drag, onto bone.
  const auto rough = [](const char* of, double strength, double friction) {
    ModeSpec mode;
    mode.kind = ModeKind::kIsosurface;
    mode.of = of;
    mode.solid = Solid::kBelow;
    mode.strength = strength;
    mode.friction = friction;
    return mode;
  };
  ModeSpec tissue;
  tissue.kind = ModeKind::kViscosity;
  tissue.of = "skin";
  tissue.strength = 0.3;
  GraphSpec spec;
  spec.modes = {rough("skin", 0.8, 0.2), tissue, rough("bone", 3.0, 0.4)};
  Random random(66);
  const long cases = test::cases(200);
  for (long i = 0; i < cases; ++i) {
    const double radius = random.uniform(5e-3, 3e-2);
    const auto scene = makeScene(spec,
                                 {{"skin", makeSphere(Vec3::Zero(), radius)},
                                  {"bone", makeSphere(Vec3(0, 0, -1e-3), radius - 1e-4)}},
                                 {500.0, 0.0});
    Reader reader;
    ProxyState state(ForceLimits{1000.0, 1e9});
    Vec3 hand(0.0, 0.0, radius + 1e-3);
    Vec3 way = Vec3::Zero();
    for (int tick = 0; tick < 2000; ++tick) {
      if (tick % 100 == 0) {
        const Vec3 to = (radius - random.uniform(-1e-3, 6e-3)) * random.direction();
        way = (Vec3(to.x(), to.y(), std::abs(to.z())) - hand) / 100.0;
      }
      hand += way;
      const StepReport report = hapticStep(*scene, reader, {hand}, state, 1e-4);
      CAPTURE(i, tick, report.primitives, report.iterations);
      if (report.status < StepStatus::kIterationLimit) REQUIRE(report.error_bound <= 3e-6);
    }
  }
}

TEST_CASE("a slow push along a groove with friction causes no jump of the force",
          "[modes][friction]") {
  // Two walls with friction share a load. During a slow push along the groove, the load moves from
  // one wall to the other. The walls must hold even in ticks in which Coulomb's law is not
  // satisfied. The hand's motion changes the spring's force by at most about 4 mN per tick.
  for (const double degrees : {30.0, 60.0, 80.0}) {
    for (const double mu : {0.2, 0.8}) {
      CAPTURE(degrees, mu);
      GraphSpec spec;
      std::map<std::string, FieldPtr> fields;
      for (const double side : {-1.0, 1.0}) {
        const double angle = degrees * 3.14159265358979 / 180.0;
        const std::string name = side < 0.0 ? "left" : "right";
        fields[name] =
            makeHalfSpace(Vec3::Zero(), Vec3(side * std::cos(angle), 0.0, std::sin(angle)));
        ModeSpec wall;
        wall.kind = ModeKind::kIsosurface;
        wall.of = name;
        wall.solid = Solid::kBelow;
        wall.strength = 3.0;
        wall.friction = mu;
        spec.modes.push_back(wall);
      }
      const auto scene = makeScene(spec, fields);
      Reader reader;
      ProxyState state(ForceLimits{100.0, 1e9});
      Vec3 last_hand(0, 0, 5e-4);
      Vec3 last = hapticStep(*scene, reader, {last_hand}, state, 1e-3).wanted;
      double worst = 0.0;
      for (int i = 1; i <= 3000; ++i) {
        const double t = 1e-3 * i;
        const Vec3 hand(1.5e-3 * std::sin(2.0 * t), 7.5e-6 * i / 3.0,
                        5e-4 - 3e-3 * std::min(1.0, t / 0.5));
        const Vec3 force = hapticStep(*scene, reader, {hand}, state, 1e-3).wanted;
        const double moved = kStiffness * (hand - last_hand).norm();
        worst = std::max(worst, (force - last).norm() - 2.0 * moved);
        last = force;
        last_hand = hand;
      }
      CHECK(worst <= 0.05);
    }
  }
}

TEST_CASE("a proxy that is dragged to its friction limit rests while the hand rests",
          "[modes][friction]") {
  Random random(67);
  for (int walls = 1; walls <= 3; ++walls) {
    for (int i = 0; i < 40; ++i) {
      GraphSpec spec;
      std::map<std::string, FieldPtr> fields;
      Vec3 in = Vec3::Zero();
      for (int w = 0; w < walls; ++w) {
        Vec3 normal = random.direction();
        if (normal.z() < 0.0) normal = -normal;
        ModeSpec wall;
        wall.kind = ModeKind::kIsosurface;
        wall.of = "wall " + std::to_string(w);
        wall.solid = Solid::kBelow;
        wall.strength = random.uniform(1.0, 3.0);
        wall.friction = random.uniform(0.1, 0.6);
        fields[wall.of] = makeHalfSpace(Vec3::Zero(), normal);
        spec.modes.push_back(wall);
        in -= normal;
      }
      ModeSpec drag;
      drag.kind = ModeKind::kViscosity;
      drag.of = "wall 0";
      drag.strength = 0.3;
      spec.modes.push_back(drag);
      const auto scene = makeScene(spec, fields);
      Reader reader;
      ProxyState state(ForceLimits{100.0, 1e9});
      const Vec3 away(0.0, 0.0, 4e-3);
      const Vec3 goal = random.uniform(1e-4, 1.5e-3) * in.normalized() +
                        random.uniform(0.0, 1e-3) * random.direction();
      Vec3 rests;
      double iterations = 0.0;
      for (int tick = 0; tick < 500; ++tick) {
        const Vec3 hand = away + std::min(1.0, tick / 200.0) * (goal - away);
        const StepReport r = hapticStep(*scene, reader, {hand}, state, 1e-3);
        if (tick == 300) rests = state.proxy();
        if (tick > 300) iterations += r.iterations;
      }
      CAPTURE(walls, i);
      CHECK((state.proxy() - rests).norm() <= 1e-12);
      CHECK(iterations <= 200.0 * 20.0);
    }
  }
}

TEST_CASE("a sticking proxy does not creep", "[modes][friction]") {
  ModeSpec wall;
  wall.kind = ModeKind::kIsosurface;
  wall.of = "ball";
  wall.solid = Solid::kBelow;
  wall.strength = 10.0;
  wall.friction = 0.5;
  GraphSpec spec;
  spec.modes = {wall};
  const auto scene = makeScene(spec, {{"ball", makeSphere(Vec3::Zero(), 0.05)}});
  Reader reader;
  ProxyState state(ForceLimits{100.0, 1e9});
  (void)hapticStep(*scene, reader, {Vec3(0.0501, 0, 0)}, state, 1e-3);
  // The proxy sticks where its path met the ball. The tolerance covers the ball's curvature within
  // one tick.
  const double met = 0.0009 * 0.1 / 2.1;
  StepReport first = hapticStep(*scene, reader, {Vec3(0.048, 0.0009, 0)}, state, 1e-3);
  CHECK(first.proxy.y() == Approx(met).epsilon(0.01));
  for (int i = 0; i < 10; ++i) {
    first = hapticStep(*scene, reader, {Vec3(0.048, 0.0009, 0)}, state, 1e-3);
  }
  StepReport last;
  for (int i = 0; i < 4000; ++i) {
    last = hapticStep(*scene, reader, {Vec3(0.048, 0.0009, 0)}, state, 1e-3);
  }
  CHECK((last.proxy - first.proxy).norm() < 2e-16);
  CHECK(last.wanted.y() == Approx(-kStiffness * (0.0009 - met)).epsilon(1e-3));
}

TEST_CASE("without friction solveWithFriction gives the balance of solveProxy bit for bit",
          "[modes][friction]") {
  Random random(64);
  Balance b;
  for (int i = 0; i < 200; ++i) {
    b.restart();
    for (int j = 0; j < 4; ++j) REQUIRE(b.set.tryAdd(random.primitive()));
    const Vec3 probe = random.inCube(5e-3);
    const SolveResult plain = solveProxy(probe, kStiffness, b.set.items(), Vec3::Zero());
    const SolveResult result = b.solve(probe);
    CHECK(result.proxy == plain.proxy);
    CHECK(result.error_bound == plain.error_bound);
  }
}

TEST_CASE("primitives at one place share a load and a plane without load carries no force",
          "[modes][friction]") {
  Random random(66);
  Balance b;
  for (int i = 0; i < 500; ++i) {
    b.restart();
    const Vec3 q = random.direction();
    const Vec3 t = across(q, random);
    const double wall = random.uniform(0.5, 3.0);
    const double drag = random.uniform(0.2, 0.5);
    REQUIRE(b.set.tryAdd({PrimitiveKind::kPlane, Vec3::Zero(), q, wall}));
    REQUIRE(b.set.tryAdd({PrimitiveKind::kPoint, Vec3::Zero(), Vec3::UnitX(), drag}));
    // Along the wall, the drag bears the whole load. Into the wall, plane and drag share the load
    // in proportion to their strengths.
    const double along = random.uniform(0.0, 1e-4);
    const double into = random.uniform(1e-7, 1e-4);
    CAPTURE(i, wall, drag, along, into);
    REQUIRE(b.solve(along * t).status == SolveStatus::kConverged);
    CHECK(b.forces[0].norm() <= 1e-9);
    REQUIRE(b.solve(along * t - into * q).status == SolveStatus::kConverged);
    const double share = wall / (wall + drag) * kStiffness * into;
    CHECK(q.dot(b.forces[0]) == Approx(share).epsilon(1e-6));
    // Three walls through one point can share a load in only one way.
    b.set.clear();
    for (const Vec3& n : {q, t, Vec3(q.cross(t))}) {
      const Vec3 tilted = (n + 0.1 * random.direction()).normalized();
      REQUIRE(b.set.tryAdd({PrimitiveKind::kPlane, Vec3::Zero(), tilted, wall}));
    }
    const Vec3 probe = -1e-4 * (q + t + q.cross(t));
    const SolveResult result = b.solve(probe);
    Vec3 sum = kStiffness * (probe - result.proxy);
    for (std::size_t j = 0; j < 3; ++j) sum += b.forces[j];
    CHECK(sum.norm() <= 1e-9);
  }
}

TEST_CASE("bad input is reported, and a balance with friction allocates no memory",
          "[modes][friction][realtime]") {
  Balance b;
  REQUIRE(b.set.tryAdd({PrimitiveKind::kPlane, Vec3::Zero(), Vec3::UnitZ(), 2.0}));
  REQUIRE(b.set.tryAddFriction(Vec3::Zero(), 0.5));
  REQUIRE(b.set.tryAdd({PrimitiveKind::kLine, Vec3::Zero(), Vec3(0.6, 0, 0.8), 1.0}));
  const CountScope scope;
  const SolveResult good = b.solve({1e-3, 2e-3, -3e-3});
  const SolveResult bad = b.solve(Vec3::Constant(std::nan("")), Vec3::UnitX());
  const SolveResult after = b.solve({1e-3, 2e-3, -3e-3});
  const auto counts = CountScope::counts();
  CHECK(counts.allocations == 0);
  CHECK(good.status == SolveStatus::kConverged);
  CHECK(bad.status == SolveStatus::kBadInput);
  CHECK(bad.proxy == Vec3::UnitX());
  CHECK((after.proxy - good.proxy).norm() <= good.error_bound + after.error_bound);
}

TEST_CASE("the forces of the primitives balance the spring, each within its strength and direction",
          "[solver][forces]") {
  Random random(65);
  const long cases = test::cases(20000);
  for (long i = 0; i < cases; ++i) {
    std::vector<Primitive> primitives;
    const int n = random.integer(7);
    for (int j = 0; j < n; ++j) {
      primitives.push_back(random.primitive());
      if (i % 3 == 0) primitives.back().position.setZero();
    }
    const Vec3 probe = random.inCube(5e-3);
    std::vector<Vec3> forces(primitives.size());
    const SolveResult result =
        solveProxy(probe, kStiffness, primitives, Vec3::Zero(), {}, nullptr, forces);
    CAPTURE(test::describe(probe, kStiffness, primitives));
    REQUIRE(result.status == SolveStatus::kConverged);
    Vec3 sum = -kStiffness * result.offset;
    for (const Vec3& f : forces) sum += f;
    REQUIRE(sum.norm() <= kStiffness * result.error_bound + 1e-12);
    for (std::size_t j = 0; j < primitives.size(); ++j) {
      const Primitive& p = primitives[j];
      const double along = p.direction.dot(forces[j]);
      REQUIRE(forces[j].norm() <= p.strength * (1 + 1e-9));
      switch (p.kind) {
        case PrimitiveKind::kForce:
          REQUIRE((forces[j] - p.strength * p.direction).norm() <= 1e-12);
          break;
        case PrimitiveKind::kLine:
          REQUIRE(std::abs(along) <= 1e-9);
          break;
        case PrimitiveKind::kPlane:
          REQUIRE(along >= -1e-9);
          REQUIRE((forces[j] - along * p.direction).norm() <= 1e-9);
          break;
        case PrimitiveKind::kPoint:
          break;
      }
    }
  }
}

}  // namespace palpate::friction_test
