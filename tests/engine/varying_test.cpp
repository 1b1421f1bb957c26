/// Tests primitives whose strength or direction depends on the position.
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numbers>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "palpate/engine/balance/newton.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/formula_fields.h"
#include "tests/support/random.h"
#include "tests/support/theorem.h"

namespace palpate::varying_test {
using palpate::test::Random;

namespace {

constexpr double kDt = 1e-3;
constexpr double kStiffness = 500.0;
constexpr double kVoxel = 1e-3;
const ForceLimits kOpen{1e3, 1e12};

FieldFrame frame(double metres_per_unit = 1.0) {
  return {kVoxel, metres_per_unit, {Vec3::Constant(-1), Vec3::Constant(1)}, 0.0};
}

std::unique_ptr<const Scene> sceneOf(const std::vector<ModeSpec>& modes,
                                     const std::map<std::string, FieldPtr>& fields) {
  GraphSpec spec;
  spec.modes = modes;
  return makeScene(spec, fields, {kStiffness, 0.0});
}

/// Forces and work along a path of the hand.
struct Feel {
  double change = 0.0;    ///< Largest change of the force between ticks [N].
  double second = 0.0;    ///< Largest second difference of the force [N].
  double readings = 0.0;  ///< Mean number of readings per tick.
  int unfinished = 0;     ///< Number of ticks that did not converge.
  double most = 0.0;      ///< Largest force [N].
  Vec3 proxy = Vec3::Zero();
};
template <class Path>
Feel along(const Scene& scene, int ticks, Path path) {
  Reader reader;
  ProxyState state(kOpen);
  Feel felt;
  std::array<Vec3, 3> force;
  force.fill(Vec3::Zero());
  int readings = 0;
  for (int i = 0; i < ticks; ++i) {
    const StepReport r = bench::provenStep(scene, reader, {path(i)}, state, kDt);
    force = {r.wanted, force[0], force[1]};
    readings += r.substeps;
    felt.unfinished += r.status == StepStatus::kConverged ? 0 : 1;
    felt.most = std::max(felt.most, r.wanted.norm());
    if (i > 0) felt.change = std::max(felt.change, (force[0] - force[1]).norm());
    if (i > 1) felt.second = std::max(felt.second, (force[0] - 2.0 * force[1] + force[2]).norm());
    felt.proxy = r.proxy;
  }
  felt.readings = static_cast<double>(readings) / ticks;
  return felt;
}

/// Returns the field x, in units of `metres_per_unit`.
FieldPtr height(double metres_per_unit = 1.0) {
  return makeScalarField(frame(metres_per_unit), [metres_per_unit](const Vec3& p) {
    return ScalarSample{p.x() / metres_per_unit, Vec3::UnitX(), true};
  });
}

}  // namespace

TEST_CASE(
    "the slope of a transfer curve at a knot is that of the next piece, and zero beyond the ends",
    "[transfer]") {
  const auto curve = TransferFunction::piecewise({{0, 1}, {1, 3}, {1, 5}, {3, 4}});
  CHECK(curve.slope(-0.1) == 0.0);
  CHECK(curve.slope(0.0) == 2.0);
  CHECK(curve.slope(0.9) == 2.0);
  CHECK(curve.slope(1.0) == -0.5);
  CHECK(curve.slope(3.0) == 0.0);
  CHECK(curve.slope(std::nan("")) == 0.0);
  CHECK(TransferFunction(2.0).slope(1.0) == 0.0);
}

TEST_CASE("the slope of a product is that of its values, also with a value of the mode's own",
          "[transfer]") {
  Properties properties;
  const Vec3 rise(2.0, -1.0, 0.5);
  const auto at = [&](const Vec3& p) {
    properties.scalars[0] = {0.4 + rise.dot(p), true, rise};
    properties.scalars[1] = {0.7 - rise.dot(p), true, -rise};
  };
  const auto ramp = [](double low, double high) {
    return TransferFunction::piecewise({{0.0, low}, {1.0, high}});
  };
  const Transfer product{{{ramp(1.0, 3.0), 0}, {ramp(0.5, 2.0), 1}, {ramp(4.0, 1.0), -1}}};
  constexpr double kSmall = 1e-6;
  for (const double own : {0.0, 0.3, 0.9}) {
    Vec3 expected;
    for (int a = 0; a < 3; ++a) {
      at(kSmall * Vec3::Unit(a));
      const double above = product(properties, own);
      at(-kSmall * Vec3::Unit(a));
      expected[a] = (above - product(properties, own)) / (2.0 * kSmall);
    }
    at(Vec3::Zero());
    CAPTURE(own);
    CHECK((product.slope(properties, own) - expected).norm() < 1e-8);
  }
}

TEST_CASE("a directed force that rises steeply changes smoothly with less than 1.1 readings a tick",
          "[modes][eq8]") {
  // The force rises by 2 N over `width`: two to eight times as steeply as the spring's force.
  const double width = GENERATE(2e-3, 1e-3, 0.5e-3);
  const double metres_per_unit = GENERATE(1.0, 1e-3);
  ModeSpec push;
  push.kind = ModeKind::kForce;
  push.of = "height";
  push.strength = TransferFunction::window(0.0, width / metres_per_unit, 2.0);
  const auto scene = sceneOf({push}, {{"height", height(metres_per_unit)}});
  // The hand moves in and out at 10 mm/s.
  const Feel felt = along(
      *scene, 2000, [](int i) { return Vec3(-5e-3 + 1e-5 * (i < 1000 ? i : 2000 - i), 0, 0); });
  CAPTURE(width, metres_per_unit, felt.second, felt.change, felt.readings);
  CHECK(felt.most == Approx(2.0).epsilon(0.01));
  CHECK(felt.unfinished == 0);
  CHECK(felt.second < 0.01);
  CHECK(felt.readings < 1.1);
}

TEST_CASE("a force towards an axis changes smoothly while the hand passes the axis",
          "[modes][eq8]") {
  const double strength = GENERATE(0.1, 0.5, 2.0);
  const auto radial = makeVectorField(frame(), [](const Vec3& p) {
    Mat3 J = Mat3::Zero();
    J(0, 0) = J(1, 1) = -1.0;
    return VectorSample{Vec3(-p.x(), -p.y(), 0), J, true};
  });
  ModeSpec pull;
  pull.kind = ModeKind::kForce;
  pull.of = "radial";
  pull.strength = strength;
  const auto scene = sceneOf({pull}, {{"radial", radial}});
  const double reach = strength / kStiffness;
  // The hand passes the axis at a distance of 0.01 S/k, at 10 mm/s.
  const int ticks = static_cast<int>(2.0 * reach / 1e-5);
  const Feel felt =
      along(*scene, ticks, [&](int i) { return Vec3(-reach + 1e-5 * i, 0.01 * reach, 1e-6 * i); });
  CAPTURE(strength, felt.change, felt.readings, felt.unfinished);
  CHECK(felt.change < 0.025);
  CHECK(felt.unfinished == 0);
  CHECK(felt.readings < 10.0);
}

TEST_CASE("at up to one voxel per tick the proxy keeps its radius around a vortex and on a front",
          "[modes]") {
  const double speed = GENERATE(0.05, 0.2, 0.9);  // [m/s]; up to one voxel per tick
  const bool tube = GENERATE(false, true);
  const double strength = GENERATE(0.3, 1.5);
  ModeSpec mode;
  mode.kind = tube ? ModeKind::kVortexTube : ModeKind::kFrontShape;
  mode.of = tube ? "flow" : "outwards";
  mode.strength = strength;
  const auto outwards = makeVectorField(frame(), [](const Vec3& p) {
    Mat3 J = Mat3::Zero();
    J(0, 0) = J(1, 1) = 1.0;
    return VectorSample{Vec3(p.x(), p.y(), 0), J, true};
  });
  const auto scene = sceneOf(
      {mode}, {{"flow", makeVortex(Vec3::Zero(), {0, 0, 3}, 0.2, 0.5)}, {"outwards", outwards}});
  // The hand circles the axis. In the first 20 ticks, the hand also moves outwards by half of S/k.
  // The proxy must stay at its radius.
  constexpr double kRadius = 0.02;
  const double outside = 0.5 * strength / kStiffness;
  const double turn = speed * kDt / kRadius;
  const int ticks = static_cast<int>(0.2 / (speed * kDt));
  const Feel felt = along(*scene, ticks, [&](int i) {
    const double r = kRadius + std::min(1.0, i / 20.0) * outside;
    return Vec3(r * std::cos(turn * i), r * std::sin(turn * i), 0.0);
  });
  const double drift = std::abs(felt.proxy.head<2>().norm() - kRadius) / kVoxel;
  CAPTURE(speed, tube, strength, drift, felt.readings, felt.second, felt.unfinished);
  CHECK(drift < 1e-3);
  CHECK(felt.readings < 3.0);
  CHECK(felt.unfinished == 0);
}

TEST_CASE("a converged tick is within a quarter voxel of the balance for random rising strengths",
          "[modes]") {
  // The force grows with x, so there is exactly one balance. The test finds it by bisection.
  Random random(63);
  const long cases = test::cases(400);
  int told = 0;
  int off = 0;
  for (long c = 0; c < cases; ++c) {
    std::vector<TransferFunction::Knot> knots;
    double at = -4e-3;
    double strength = 0.0;
    while (at < 4e-3) {
      knots.emplace_back(at, strength);
      at += random.logUniform(0.05e-3, 2e-3);
      strength += random.uniform(0.0, 1.0) < 0.3 ? 0.0 : random.logUniform(0.01, 1.0);
    }
    ModeSpec push;
    push.kind = ModeKind::kForce;
    push.of = "height";
    push.strength = TransferFunction::piecewise(knots);
    const TransferFunction curve = TransferFunction::piecewise(knots);
    const auto scene = sceneOf({push}, {{"height", height()}});
    Reader reader;
    ProxyState state(kOpen);
    double hand = -5e-3;
    for (int i = 0; i < 60; ++i) {
      hand = std::clamp(hand + 2e-3 * random.inCube(1.0).x(), -6e-3, 12e-3);
      const StepReport r = bench::provenStep(*scene, reader, {Vec3(hand, 0, 0)}, state, kDt);
      if (r.status != StepStatus::kConverged) continue;
      ++told;
      double low = hand - 20e-3;
      double high = hand;
      for (int n = 0; n < 60; ++n) {
        const double middle = 0.5 * (low + high);
        (kStiffness * (hand - middle) > curve(middle) ? low : high) = middle;
      }
      CAPTURE(c, i, hand, r.proxy.x(), low);
      // A tick ends after a step that is shorter than the tolerance. If the balance is at a knot of
      // the curve, this last step can be too short.
      off += std::abs(r.proxy.x() - low) <= 0.01 * kVoxel + 1e-12 ? 0 : 1;
      CHECK(std::abs(r.proxy.x() - low) <= 0.25 * kVoxel);
    }
  }
  CHECK(told > 59 * cases);
  CHECK(off <= 5 + told / 500);
}

TEST_CASE("Newton's step extrapolates a strength that was read beside the proxy", "[newton]") {
  // The strength is a linear function of the position. So one step from a reading at `read` must
  // lead exactly to the balance, with the strength at the balance.
  const double slope = GENERATE(-300.0, 800.0);
  const Vec3 read(1e-3, 2e-3, 0);
  const Vec3 from(1.3e-3, 2.1e-3, 1e-4);
  const Vec3 probe(2e-3, 2e-3, 0);
  const Primitive push{PrimitiveKind::kForce, Vec3::Zero(), -Vec3::UnitX(), 0.5 + slope * read.x()};
  const Vec3 force = push.strength * push.direction;
  Varying varies;
  varies.slope = slope * Vec3::UnitX();
  const std::array<Varying, 1> varying{varies};
  const Vec3 balance = probe + force / kStiffness;
  const Vec3 x = from + newtonStep(balance, from, read, kStiffness, std::array{push},
                                   std::array{force}, varying);
  CHECK((x - (probe - (0.5 + slope * x.x()) / kStiffness * Vec3::UnitX())).norm() < 1e-15);
}

TEST_CASE("slopes and Jacobians of properties match finite differences, also in moved volumes",
          "[modes][graph]") {
  // Values are in units of 3 mm. The strengths depend on a vector's magnitude, its direction, and a
  // product of curves.
  const double unit_size = 3e-3;
  const auto hill = makeScalarField(frame(unit_size), [=](const Vec3& p) {
    const Vec3 u = p / unit_size;
    return ScalarSample{std::sin(u.x()) + u.y() * u.z(), Vec3(std::cos(u.x()), u.z(), u.y()), true};
  });
  const auto flow = makeVectorField(frame(unit_size), [=](const Vec3& p) {
    const Vec3 u = p / unit_size;
    Mat3 J;
    J << 0, 1, 0, std::cos(u.x()), 0, 0, 0, u.z(), u.y();
    return VectorSample{Vec3(u.y() + 3.0, std::sin(u.x()), u.y() * u.z()), J, true};
  });
  ModeSpec pull;
  pull.kind = ModeKind::kForce;
  pull.of = "direction";
  pull.strength = TransferSpec(
      std::vector<TransferSpec::Factor>{{TransferFunction::piecewise({{-50, 0}, {50, 1}}), "hill"},
                                        {TransferFunction::piecewise({{0, 0}, {50, 2}}), "speed"}});
  ModeSpec slope;
  slope.kind = ModeKind::kForce;
  slope.of = "hill";
  GraphSpec spec;
  spec.modes = {pull, slope};
  spec.modes[1].strength = 1.0;
  spec.fields = {{"speed", {Derivation::kMagnitude, "flow"}},
                 {"direction", {Derivation::kUnit, "flow"}}};
  std::vector<Keyframe> keys(2);
  keys[1].time = 1.0;
  const Eigen::Quaterniond q(Eigen::AngleAxisd(0.7, Vec3(0.2, 0.9, -0.3).normalized()));
  keys[1].rotation_wxyz = {q.w(), q.x(), q.y(), q.z()};
  const auto motion = std::make_shared<const Motion>(keys, false);
  const bool moves = GENERATE(false, true);
  if (moves) spec.motions = {{"hill", motion}, {"flow", motion}};
  const auto scene = makeScene(spec, {{"hill", hill}, {"flow", flow}}, {kStiffness, 0.0});
  Reader reader;
  const BoundGraph graph = reader.bind(*scene);
  Random random(61);
  for (int c = 0; c < 200; ++c) {
    // Reads the properties at p, in the moving volume's frame of rest.
    std::vector<Body> bodies(moves ? 1 : 0);
    const auto readAt = [&](const Vec3& p, Properties& out) {
      for (Body& body : bodies) {
        body.pose = motion->poseAt(0.6);
        body.seen = body.pose.toRest(p);
        body.moved = false;
      }
      (void)graph.sample(p, out, bodies);
    };
    const Vec3 p = random.inCube(5e-3);
    Properties at;
    Properties above;
    Properties below;
    readAt(p, at);
    const Graph& names = *graph.graph;
    const auto vector = [&](const char* name) {
      const auto& all = names.vector_properties;
      const auto i = std::find(all.begin(), all.end(), name) - all.begin();
      REQUIRE(static_cast<std::size_t>(i) < all.size());
      return static_cast<std::size_t>(i);
    };
    const std::size_t direction = vector("unit of flow");
    const std::size_t gradient = vector("gradient of hill");
    const Transfer& strength = std::get<ForceMode>(names.modes[0]).strength;
    constexpr double kStep = 1e-6;
    for (int a = 0; a < 3; ++a) {
      readAt(p + kStep * Vec3::Unit(a), above);
      readAt(p - kStep * Vec3::Unit(a), below);
      const double rate = (strength(above) - strength(below)) / (2.0 * kStep);
      CHECK(strength.slope(at)[a] == Approx(rate).margin(1e-4));
      for (const std::size_t v : {direction, gradient}) {
        const Vec3 turn = (above.vectors[v].value - below.vectors[v].value) / (2.0 * kStep);
        CHECK((at.vectors[v].jacobian.col(a) - turn).norm() < 1e-3 * (1.0 + turn.norm()));
      }
    }
    if (!moves) continue;
    // A reading that was moved with its volume must equal a new reading.
    Properties fresh;
    Body& body = bodies[0];
    const Pose before = body.pose;
    const Vec3 rest = before.toRest(p);
    body.pose = motion->poseAt(0.9);
    body.seen = rest;
    body.carry = Pose::rigid(body.pose.linear * before.back, Vec3::Zero());
    body.moved = true;
    (void)graph.sample(body.pose(rest), fresh, bodies);
    graph.turn(at, bodies);
    for (const std::size_t v : {direction, gradient}) {
      CHECK((at.vectors[v].value - fresh.vectors[v].value).norm() < 1e-9);
      CHECK((at.vectors[v].jacobian - fresh.vectors[v].jacobian).norm() <
            1e-6 * (1.0 + fresh.vectors[v].jacobian.norm()));
    }
    CHECK((strength.slope(at) - strength.slope(fresh)).norm() <
          1e-9 * (1.0 + strength.slope(fresh).norm()));
  }
}

TEST_CASE("Newton's step is of second order for varying strengths and directions", "[newton]") {
  // A smooth force s(x) d(x), and a yielding point whose strength has a slope.
  const auto force = [](const Vec3& x, Vec3& d, Varying& varies) {
    const Vec3 u = x / 1e-3;
    const Vec3 v(1.0 + 0.2 * u.y(), 0.3 * u.x() * u.x(), 0.5 + 0.1 * u.z());
    Mat3 J;
    J << 0, 0.2, 0, 0.6 * u.x(), 0, 0, 0, 0, 0.1;
    d = v.normalized();
    varies.turn = turnOf(v, J / 1e-3);
    varies.slope = Vec3(0.3 * u.x(), 0.2, -0.1) / 1e-3;
    return 1.0 + 0.15 * u.x() * u.x() + 0.2 * u.y() - 0.1 * u.z();
  };
  Random random(62);
  int tried = 0;
  for (int c = 0; c < 300; ++c) {
    const Vec3 probe = random.inCube(1e-3);
    const Vec3 drag_at = probe + 0.02 * random.direction();
    const double drag = 0.1;
    const auto stepFrom = [&](const Vec3& x, double& residual) {
      std::array<Primitive, 2> primitives;
      Varying varies;
      primitives[0].kind = PrimitiveKind::kForce;
      primitives[0].strength = force(x, primitives[0].direction, varies);
      primitives[1] = {PrimitiveKind::kPoint, drag_at, Vec3::UnitX(),
                       drag * (1.0 + (x - probe).x() / 5e-3)};
      Varying of_drag;
      of_drag.index = 1;
      of_drag.slope = drag / 5e-3 * Vec3::UnitX();
      std::array<Vec3, 2> forces;
      SolverParams params;
      params.tolerance = 1e-12;
      const SolveResult solved = solveProxy(probe, 1000.0, primitives, x, params, nullptr, forces);
      residual = (solved.proxy - x).norm();
      return newtonStep(solved.proxy, x, x, 1000.0, primitives, forces,
                        std::array<Varying, 2>{varies, of_drag});
    };
    Vec3 x = probe;
    std::array<double, 8> residuals{};
    for (double& residual : residuals) x += stepFrom(x, residual);
    if (residuals[1] > 3e-4) continue;  // skips starts outside the range of quadratic convergence
    ++tried;
    CHECK(residuals[2] <= 4e3 * residuals[1] * residuals[1] + 1e-12);
    CHECK(residuals[4] <= 1e-12);
  }
  CHECK(tried > 200);
}

}  // namespace palpate::varying_test
