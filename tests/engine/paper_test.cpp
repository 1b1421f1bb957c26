/// Tests claims of Lundin et al., "The Orthogonal Constraints Problem ...", one by one.
#include <algorithm>
#include <cmath>
#include <iostream>
#include <vector>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "palpate/bench/methods/constraint_approach.h"
#include "palpate/bench/methods/euler_adaptive.h"
#include "palpate/bench/methods/force_function.h"
#include "palpate/bench/methods/residual.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/formula_fields.h"
#include "tests/support/problems.h"
#include "tests/support/random.h"
#include "tests/support/reference_solver.h"

namespace palpate::paper_test {
using palpate::methods::Constraint;
using palpate::methods::constraintProxy;
using palpate::methods::residualForce;
using palpate::test::describe;
using palpate::test::Random;
using palpate::test::solveReference;

namespace {

constexpr double kStiffness = 500.0;
constexpr double kDt = 1e-3;
const ForceLimits kOpen{100.0, 1e9};

/// Returns the force of one primitive on a proxy at x by eqs (8) to (13) of the paper. Requires
/// that x is not on a kink.
Vec3 printedForce(const Primitive& p, const Vec3& x) {
  const Vec3 q = p.direction;
  switch (p.kind) {
    case PrimitiveKind::kForce:
      return p.strength * q;
    case PrimitiveKind::kPoint:
      return p.strength * (p.position - x) / (p.position - x).norm();
    case PrimitiveKind::kLine: {
      const Vec3 m = q * q.dot(x - p.position) - (x - p.position);  // eq. (10)
      return p.strength * m / m.norm();
    }
    case PrimitiveKind::kPlane:
      return (x - p.position).dot(q) < 0.0 ? Vec3(p.strength * q) : Vec3(Vec3::Zero());  // eq. (12)
  }
  return Vec3::Zero();
}

ModeSpec mode(ModeKind kind, const std::string& of, TransferFunction strength) {
  ModeSpec spec;
  spec.kind = kind;
  spec.of = of;
  spec.strength = std::move(strength);
  spec.solid = Solid::kBelow;
  return spec;
}

/// Returns the smallest |f_res| at x and on a circle of radius 0.1 um about x.
double smallestResidualNear(const Vec3& x, const Vec3& probe,
                            const std::vector<Primitive>& planes) {
  double least = residualForce(x - probe, probe, kStiffness, planes).norm();
  for (int i = 0; i < 720; ++i) {
    const double a = i * M_PI / 360.0;
    const Vec3 y = x + 1e-7 * Vec3(std::cos(a), std::sin(a), 0);
    least = std::min(least, residualForce(y - probe, probe, kStiffness, planes).norm());
  }
  return least;
}

}  // namespace

TEST_CASE("fig. 1: a tick reads properties before it moves the proxy and computes the force",
          "[paper][fig1][eq3]") {
  // The ground is a surface with a drag. Its field records the positions of all readings.
  std::vector<Vec3> read;
  const FieldPtr ground = makeScalarField(
      FieldFrame{1e-3, 1.0, {Vec3::Constant(-1), Vec3::Constant(1)}}, [&read](const Vec3& p) {
        read.push_back(p);
        return ScalarSample{p.z(), Vec3::UnitZ(), true};
      });
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kSurface, "ground", 1.0), mode(ModeKind::kViscosity, "ground", 0.3)};
  const CouplingParams coupling{kStiffness, 0.5};
  const auto scene = makeScene(spec, {{"ground", ground}}, coupling);
  Reader reader;
  ProxyState state(kOpen);
  std::vector<double> lengths;
  std::vector<Primitive> known;
  double farthest = 0.0;
  for (int tick = 0; tick < 100; ++tick) {
    const Vec3 hand(2e-5 * tick, 0, -5e-5 * tick);
    const Vec3 before = tick == 0 ? hand : state.proxy();
    read.clear();
    const StepReport r = hapticStep(*scene, reader, {hand}, state, kDt);
    CAPTURE(tick);
    // Step 1 reads the local properties. The paper reads them at the old proxy. The engine reads
    // them at the position to which the last tick's constraints lead the proxy, because the
    // constraints must hold there. Each tick after the first reads the ground once.
    REQUIRE(r.samples == (tick == 0 ? 2 : 1));
    if (tick > 0) {
      for (Primitive& p : known) p.position = before;
      const test::Reference foreseen = solveReference(hand, kStiffness, known);
      // The first call of the field is at that position. Further calls around it measure how the
      // normal changes, and do not count as samples.
      REQUIRE((read.front() - hand - foreseen.offset).norm() < 1e-9);
    }
    // Step 2 places the constraints at the old proxy, and moves the proxy to the position at which
    // the constraints balance the spring.
    const auto items = state.primitives().items();
    known.assign(items.begin(), items.end());
    REQUIRE(known.size() == 2);
    REQUIRE(distanceTo(known[0], before) < 1e-12);
    REQUIRE(known[1].position == before);
    const test::Reference reference = solveReference(hand, kStiffness, known);
    const Vec3 offset = r.proxy - hand;
    REQUIRE((offset - reference.offset).norm() <= r.error_bound + reference.error_bound + 1e-15);
    // Step 3 computes the force from the new proxy by eq. (3).
    lengths.push_back(offset.norm());
    const int back = std::min(tick, static_cast<int>(kRateTime / kDt + 0.5));
    const double then = lengths[static_cast<std::size_t>(tick - back)];
    const double rate = back == 0 ? 0.0 : (lengths.back() - then) / (back * kDt);
    REQUIRE((r.force - couplingForce(coupling, offset, rate)).norm() < 1e-9);
    farthest = std::max(farthest, (before - hand).norm());
  }
  CHECK(farthest > 1e-3);  // otherwise the position of the reading would not matter
}

TEST_CASE("eqs 1 and 2: a constraint moves the proxy as a plane does, and only along its direction",
          "[paper][eq1][eq2]") {
  Random random(31);
  int yielded = 0;
  for (int i = 0; i < 300; ++i) {
    const Vec3 proxy = random.inCube(2e-3);
    const Vec3 q = random.direction();
    const double s = random.uniform(0.0, 2.0);
    Vec3 probe = random.inCube(5e-3);
    if ((probe - proxy).dot(q) < 0.0) probe -= 2.0 * (probe - proxy).dot(q) * q;
    const Vec3 eta = probe - proxy;
    const bool yields = s < kStiffness * eta.dot(q);
    const Vec3 moved = yields ? Vec3(q * (eta.dot(q) - s / kStiffness)) : Vec3(Vec3::Zero());
    yielded += static_cast<int>(yields);
    const std::vector<Constraint> constraint{{q, s}};
    REQUIRE((constraintProxy(probe, proxy, kStiffness, constraint) - proxy - moved).norm() < 1e-15);
    // In eq. (2), q points from the proxy towards the hand; in eq. (13), in the opposite direction.
    const std::vector<Primitive> plane{{PrimitiveKind::kPlane, proxy, -q, s}};
    const SolveResult solved = solveProxy(probe, kStiffness, plane, proxy);
    REQUIRE(std::abs(q.dot(solved.proxy - proxy - moved)) < 1e-15);
  }
  CHECK(yielded > 50);
  CHECK(yielded < 250);
}

TEST_CASE("eq. 7 holds if and only if the directions are orthogonal",
          "[paper][eq4][eq5][eq6][eq7]") {
  // Eq. (5) adds (sum q q^T - 1) eta to eta. This matrix has the same largest singular value as Q^T
  // Q - 1, whose off-diagonal elements are the cosines between the directions. No element exceeds
  // the largest singular value.
  Random random(32);
  for (int i = 0; i < 300; ++i) {
    Mat3 Q = Eigen::AngleAxisd(random.uniform(-3, 3), random.direction()).toRotationMatrix();
    const bool orthogonal = i % 10 == 0;
    if (!orthogonal) Q << random.direction(), random.direction(), random.direction();
    std::vector<Constraint> constraints;
    for (int j = 0; j < 3; ++j) constraints.push_back({Q.col(j), 0.0});
    const Eigen::SelfAdjointEigenSolver<Mat3> added(Q * Q.transpose() - Mat3::Identity());
    double worst = 0.0;  // largest gain over the eigenvectors of the added matrix
    for (int j = 0; j < 3; ++j) {
      const Vec3 proxy = random.inCube(1e-2);
      const Vec3 probe = proxy + 5e-3 * added.eigenvectors().col(j);
      const Vec3 off = constraintProxy(probe, proxy, kStiffness, constraints) - probe;
      worst = std::max(worst, off.norm() / 5e-3);
    }
    const double cosine = (Q.transpose() * Q - Mat3::Identity()).cwiseAbs().maxCoeff();
    CAPTURE(i, cosine);
    CHECK(worst >= cosine * (1 - 1e-9) - 1e-12);
    if (orthogonal) CHECK(worst < 1e-12);
    // Planes without strength give no force, whatever their directions.
    std::vector<Primitive> planes;
    for (int j = 0; j < 3; ++j) {
      planes.push_back({PrimitiveKind::kPlane, Vec3::Zero(), Q.col(j), 0.0});
      planes.push_back({PrimitiveKind::kPlane, Vec3::Zero(), -Q.col(j), 0.0});
    }
    CHECK(solveProxy(random.inCube(5e-3), kStiffness, planes, Vec3::Zero()).offset.norm() == 0.0);
  }
}

TEST_CASE(
    "fig. 2: weak non-orthogonal constraints give a spurious force, and weak primitives do not",
    "[paper][fig2][eq7]") {
  Random random(2);
  std::cout
      << "strength N | eq. (2) force N | primitives N | their sum N | reference N  (largest of "
         "200 sets of 3)\n";
  for (double strength = 1e-9; strength < 2e-2; strength *= 10.0) {
    double constraint_force = 0.0;
    double primitive_force = 0.0;
    double reference_force = 0.0;
    for (int i = 0; i < 200; ++i) {
      // Three constraints at the old proxy, with directions 10 to 60 degrees from a common axis.
      // The hand is 5 mm away.
      const Vec3 proxy = random.inCube(1e-2);
      const Vec3 probe = proxy + 5e-3 * random.direction();
      const Vec3 axis = random.direction();
      std::vector<Constraint> constraints;
      std::vector<Primitive> planes;
      for (int j = 0; j < 3; ++j) {
        const double angle = random.uniform(10.0, 60.0) * M_PI / 180.0;
        const Vec3 q = Eigen::AngleAxisd(angle, axis.cross(random.direction()).normalized()) * axis;
        constraints.push_back({q, strength});
        planes.push_back({PrimitiveKind::kPlane, proxy, q, strength});
      }
      const Vec3 old_way =
          kStiffness * (constraintProxy(probe, proxy, kStiffness, constraints) - probe);
      const SolveResult solved = solveProxy(probe, kStiffness, planes, proxy);
      const test::Reference reference = solveReference(probe, kStiffness, planes);
      const double force = kStiffness * solved.offset.norm();
      CAPTURE(describe(probe, kStiffness, planes));
      REQUIRE(force <= 3.0 * strength * (1.0 + 1e-6));
      REQUIRE(kStiffness * (solved.offset - reference.offset).norm() <=
              kStiffness * (solved.error_bound + reference.error_bound));
      REQUIRE(kStiffness * (solved.offset - reference.offset).norm() <= 1e-5 * 3.0 * strength);
      constraint_force = std::max(constraint_force, old_way.norm());
      primitive_force = std::max(primitive_force, force);
      reference_force = std::max(reference_force, kStiffness * reference.offset.norm());
    }
    std::cout << strength << " | " << constraint_force << " | " << primitive_force << " | "
              << 3.0 * strength << " | " << reference_force << '\n';
    // The constraint approach fails: its force is above 1 N and above 100 times the summed
    // strength.
    CHECK(constraint_force > 1.0);
    CHECK(constraint_force > 100.0 * 3.0 * strength);
  }
}

TEST_CASE("weak primitives of any kind give a force of at most their summed strength", "[paper]") {
  Random random(4);
  for (double strength = 1e-9; strength < 2e-2; strength *= 10.0) {
    for (int i = 0; i < 100; ++i) {
      const Vec3 probe = random.inCube(5e-3);
      std::vector<Primitive> set;
      double sum = 0.0;
      for (int j = 0; j < 4; ++j) {
        set.push_back(random.primitive());
        set.back().strength = strength * random.uniform(0.1, 1.0);
        sum += set.back().strength;
      }
      const SolveResult solved = solveProxy(probe, kStiffness, set, probe);
      const test::Reference reference = solveReference(probe, kStiffness, set);
      CAPTURE(describe(probe, kStiffness, set));
      REQUIRE(kStiffness * solved.offset.norm() <= sum * (1.0 + 1e-6));
      REQUIRE(kStiffness * (solved.offset - reference.offset).norm() <= 1e-5 * sum);
    }
  }
}

TEST_CASE("fig. 2 a: weak orthogonal constraints give the correct balance, and so do weak planes",
          "[paper][fig2]") {
  Random random(3);
  for (int i = 0; i < 100; ++i) {
    const Mat3 R = Eigen::AngleAxisd(random.uniform(-3, 3), random.direction()).toRotationMatrix();
    const Vec3 probe = random.inCube(5e-3);
    std::vector<Constraint> constraints;
    std::vector<Primitive> planes;
    for (int j = 0; j < 3; ++j) {
      constraints.push_back({R.col(j), 0.0});
      planes.push_back({PrimitiveKind::kPlane, Vec3::Zero(), R.col(j), 1e-9});
      planes.push_back({PrimitiveKind::kPlane, Vec3::Zero(), -R.col(j), 1e-9});
    }
    CHECK((constraintProxy(probe, Vec3::Zero(), kStiffness, constraints) - probe).norm() < 1e-16);
    // Along each direction the force is at most the strength of 1e-9 N.
    const SolveResult solved = solveProxy(probe, kStiffness, planes, probe);
    CHECK(kStiffness * solved.offset.norm() <= std::sqrt(3.0) * 1e-9 * (1 + 1e-5));
  }
}

TEST_CASE("section 3.1: n parallel constraints multiply the error by 1 - n each tick", "[paper]") {
  const int n = GENERATE(2, 3, 4);
  const std::vector<Constraint> constraints(static_cast<std::size_t>(n), {Vec3::UnitX(), 0.0});
  Vec3 proxy(1e-3, 0, 0);
  double error = 1e-3;
  for (int tick = 0; tick < 5; ++tick) {
    proxy = constraintProxy(Vec3::Zero(), proxy, kStiffness, constraints);
    error *= 1 - n;
    CHECK(proxy.x() == Approx(error));
  }
  const std::vector<Primitive> planes(static_cast<std::size_t>(n),
                                      {PrimitiveKind::kPlane, {1e-3, 0, 0}, Vec3::UnitX(), 1e-9});
  CHECK(kStiffness * solveProxy(Vec3::Zero(), kStiffness, planes, Vec3::Zero()).offset.norm() <=
        n * 1e-9 * (1 + 1e-6));
}

TEST_CASE("section 3.2: two objects, a stream and its curl balance together in each tick",
          "[paper]") {
  // A ball is half inside the ground, in a stream that twists about its own axis.
  GraphSpec spec;
  spec.fields = {{"spin", {Derivation::kCurl, "flow"}}};
  spec.modes = {mode(ModeKind::kIsosurface, "ball", 2.0),
                mode(ModeKind::kIsosurface, "ground", 1.5), mode(ModeKind::kFollow, "flow", 0.7),
                mode(ModeKind::kForce, "spin", 0.2)};
  const auto scene = makeScene(spec, {{"ball", makeSphere(Vec3::Zero(), 0.03)},
                                      {"ground", makeHalfSpace(Vec3::Zero(), Vec3::UnitZ())},
                                      {"flow", makeVortex(Vec3::Zero(), {1, 2, 3}, 0.2, 1.0)}});
  Random random(33);
  Reader reader;
  ProxyState state(kOpen);
  const Vec3 corner(0.029, 0, -0.001);  // behind both surfaces
  Vec3 hand(0.035, 0, 5e-3);
  Vec3 before = hand;
  int several = 0;
  double old_error = 0.0;
  for (int tick = 0; tick < 2000; ++tick) {
    hand += 2e-4 * random.inCube(1.0) - 1e-2 * (hand - corner);
    const StepReport r = hapticStep(*scene, reader, {hand}, state, kDt);
    const std::vector<Primitive> set(state.primitives().items().begin(),
                                     state.primitives().items().end());
    const Vec3 start = before;
    before = r.proxy;
    if (tick % 10 != 0 || r.status != StepStatus::kConverged || set.size() < 4) continue;
    ++several;
    // The stream is curved, so part of the pull waits for the next tick.
    const Vec3 probe = hand + r.waiting;
    const test::Reference reference = solveReference(probe, kStiffness, set);
    CAPTURE(describe(probe, kStiffness, set));
    REQUIRE((r.proxy - probe - reference.offset).norm() <=
            r.error_bound + reference.error_bound + 1e-15);
    const Vec3 old_way = methods::constraintApproach(probe, kStiffness, set, start).offset;
    old_error = std::max(old_error, kStiffness * (old_way - reference.offset).norm());
  }
  CHECK(several > 20);
  CHECK(old_error > 0.5);  // [N]; error if the constraints are applied one after the other
}

TEST_CASE("fig. 3: at the proxy the paper's force of a primitive balances the spring",
          "[paper][fig3][eq8][eq9][eq10][eq11][eq12][eq13]") {
  Random random(34);
  for (int i = 0; i < 1000; ++i) {
    const Primitive p = random.primitive();
    const Vec3 x = random.inCube(5e-3);
    const Vec3 f = printedForce(p, x);
    CAPTURE(describe(x, kStiffness, {p}), f);
    CHECK((f - methods::forceOf(p, x - p.position)).norm() < 1e-12);
    // In the figure, the force has full strength and points to the nearest point at which the
    // primitive has no force.
    const Vec3 d = x - p.position;
    if (p.kind == PrimitiveKind::kPoint) {
      CHECK((x + d.norm() / p.strength * f - p.position).norm() < 1e-12);
    } else if (p.kind == PrimitiveKind::kLine) {
      const Vec3 foot = x + d.cross(p.direction).norm() / p.strength * f;
      CHECK((foot - p.position).cross(p.direction).norm() < 1e-12);
    } else if (p.kind == PrimitiveKind::kPlane) {
      CHECK(f.norm() == Approx(d.dot(p.direction) < 0.0 ? p.strength : 0.0).margin(1e-12));
    } else {
      CHECK(f.norm() == Approx(p.strength));
    }
    // In balance, the spring acts on the proxy with -f, and the hand feels f.
    const std::vector<Primitive> set{p};
    const SolveResult solved = solveProxy(x - f / kStiffness, kStiffness, set, Vec3::Zero());
    CHECK((kStiffness * solved.offset - f).norm() < 1e-12);
  }
}

TEST_CASE("eqs 14 and 15: at the proxy the paper's forces and the spring add up to zero",
          "[paper][eq14][eq15]") {
  Random random(35);
  for (int i = 0; i < 500; ++i) {
    std::vector<Primitive> set;
    const int count = 1 + random.integer(8);
    for (int j = 0; j < count; ++j) set.push_back(random.primitive());
    // Each x that is not on a kink is the proxy of exactly one probe.
    const Vec3 x = random.inCube(3e-3);
    Vec3 sum = Vec3::Zero();
    for (const Primitive& p : set) sum += printedForce(p, x);
    const Vec3 probe = x - sum / kStiffness;
    CAPTURE(describe(probe, kStiffness, set));
    CHECK(residualForce(x - probe, probe, kStiffness, set).norm() < 1e-12);
    const SolveResult solved = solveProxy(probe, kStiffness, set, Vec3::Zero());
    const test::Reference reference = solveReference(probe, kStiffness, set);
    CHECK((solved.proxy - x).norm() <= solved.error_bound + 1e-15);
    CHECK((reference.offset - (x - probe)).norm() <= reference.error_bound + 1e-15);
  }
}

TEST_CASE("eq. 8: a directed force acts with its full strength, alone and among other primitives",
          "[paper][eq8]") {
  Random random(36);
  for (int i = 0; i < 200; ++i) {
    const Vec3 probe = random.inCube(5e-3);
    Primitive push = random.primitive();
    push.kind = PrimitiveKind::kForce;
    // A directed force alone gives the hand its full strength.
    std::vector<Primitive> set{push};
    const Vec3 alone = solveProxy(probe, kStiffness, set, probe).offset;
    CHECK((alone - methods::forceFunction(probe, kStiffness, set, probe).offset).norm() < 1e-15);
    // Among other primitives, the force acts as if the hand were s/k farther along the force.
    std::vector<Primitive> others{random.primitive(), random.primitive(), random.primitive()};
    const Vec3 moved_probe = probe + push.strength / kStiffness * push.direction;
    const SolveResult moved = solveProxy(moved_probe, kStiffness, others, probe);
    set.insert(set.end(), others.begin(), others.end());
    const SolveResult all = solveProxy(probe, kStiffness, set, probe);
    CAPTURE(describe(probe, kStiffness, set));
    CHECK((all.proxy - moved.proxy).norm() <= all.error_bound + moved.error_bound + 1e-15);
  }
}

TEST_CASE("fig. 4: the spring balances the sum of a plane's and a point's force",
          "[paper][fig4][eq15]") {
  const Vec3 q = Vec3(1, 0, 3).normalized();
  const Primitive plane{PrimitiveKind::kPlane, Vec3::Zero(), q, 1.0};
  Random random(37);
  int before = 0;
  int on = 0;
  int behind = 0;
  for (int i = 0; i < 600; ++i) {
    const Primitive point{PrimitiveKind::kPoint, random.inCube(2e-3), Vec3::UnitX(), 0.6};
    const std::vector<Primitive> set{plane, point};
    const Vec3 probe = random.inCube(5e-3);
    const SolveResult solved = solveProxy(probe, kStiffness, set, probe);
    const test::Reference reference = solveReference(probe, kStiffness, set);
    CAPTURE(describe(probe, kStiffness, set));
    REQUIRE((solved.offset - reference.offset).norm() <=
            solved.error_bound + reference.error_bound);
    if ((solved.proxy - point.position).norm() < 1e-5) continue;  // the point holds the proxy too
    // The plane's force is the difference between the spring's and the point's force, along the
    // plane's normal. Behind the plane, this force is the full strength; in front of the plane, it
    // is zero. On the plane, it is between zero and the strength.
    const Vec3 left = kStiffness * solved.offset - printedForce(point, solved.proxy);
    const double along = left.dot(q);
    const double height = solved.proxy.dot(q);
    CHECK((left - along * q).norm() < 1e-5);
    CHECK(along > -1e-5);
    CHECK(along < 1.0 + 1e-5);
    if (height > 1e-9) CHECK(std::abs(along) < 1e-5);
    if (height < -1e-9) CHECK(along == Approx(1.0).margin(1e-5));
    ++(height > 1e-9 ? before : height < -1e-9 ? behind : on);
  }
  CHECK(before > 50);
  CHECK(on > 50);
  CHECK(behind > 50);
}

TEST_CASE(
    "section 4.2: the residual force of eq. 14 does not vanish near a plane that holds the proxy",
    "[paper][eq14][fig5]") {
  const std::vector<Primitive> set{{PrimitiveKind::kPlane, Vec3::Zero(), Vec3::UnitZ(), 1.0}};
  for (const double pull : {0.1, 0.5, 0.8}) {
    const Vec3 probe(0, 0, -pull / kStiffness);
    const SolveResult solved = solveProxy(probe, kStiffness, set, probe);
    CHECK(solved.error_bound < 1e-15);
    // On and above the plane, the residual is the spring's force. Below the plane, the residual is
    // the strength minus the spring's force. So the residual is at least the smaller value.
    const double left = std::min(pull, 1.0 - pull);
    CHECK(residualForce(solved.offset, probe, kStiffness, set).norm() >= left * (1 - 1e-9));
    CHECK(smallestResidualNear(solved.proxy, probe, set) >= left * (1 - 1e-3));
  }
}

TEST_CASE("section 4.2: damping changes the force but not the balance (D = 0 in the balance)",
          "[paper][eq3]") {
  GraphSpec spec;
  spec.modes = {mode(ModeKind::kIsosurface, "ball", 2.0), mode(ModeKind::kViscosity, "ball", 0.3)};
  const FieldPtr ball = makeSphere(Vec3::Zero(), 0.03);
  const auto bare = makeScene(spec, {{"ball", ball}}, {kStiffness, 0.0});
  const auto damped = makeScene(spec, {{"ball", ball}}, {kStiffness, 2.0});
  Random random(38);
  Reader reader_a;
  Reader reader_b;
  ProxyState a(kOpen);
  ProxyState b(kOpen);
  const Vec3 top(0, 0, 0.03);
  Vec3 hand = top;
  double difference = 0.0;
  for (int tick = 0; tick < 2000; ++tick) {
    hand += 3e-4 * random.inCube(1.0) - 1e-2 * (hand - top);
    const StepReport without = hapticStep(*bare, reader_a, {hand}, a, kDt);
    const StepReport with = hapticStep(*damped, reader_b, {hand}, b, kDt);
    REQUIRE(without.proxy == with.proxy);
    difference = std::max(difference, (without.force - with.force).norm());
  }
  CHECK(difference > 0.1);
}

TEST_CASE("fig. 5: a plane balances the spring by a force within its strength", "[paper][fig5]") {
  const std::vector<Primitive> set{{PrimitiveKind::kPlane, Vec3::Zero(), Vec3::UnitZ(), 1.0}};
  const Vec3 probe(0, 0, -1e-3);
  const SolveResult r = solveProxy(probe, kStiffness, set, probe);
  CHECK(r.proxy.norm() < 1e-18);
  CHECK(kStiffness * r.offset.z() == Approx(0.5));
}

TEST_CASE("fig. 6: the proxy leaves the plane at s/k and stays s/k from the probe",
          "[paper][fig6]") {
  const double s = 2.0;
  const std::vector<Primitive> set{{PrimitiveKind::kPlane, Vec3::Zero(), Vec3::UnitZ(), s}};
  for (double depth = 0.0; depth < 10e-3; depth += 1e-4) {
    const Vec3 probe(3e-3, 0, -depth);
    const SolveResult r = solveProxy(probe, kStiffness, set, probe);
    CHECK(r.offset.z() == Approx(std::min(depth, s / kStiffness)).margin(1e-17));
    CHECK(r.offset.head<2>().norm() < 1e-17);
  }
}

TEST_CASE("section 4.2: the smallest |f_res| is not always at the balance", "[paper][eq15]") {
  const bench::BalanceProblem pair = bench::makeMisledPair();
  const std::vector<Primitive>& planes = pair.primitives;
  const Vec3& probe = pair.probe;
  REQUIRE(pair.stiffness == kStiffness);
  const SolveResult solved = solveProxy(probe, kStiffness, planes, probe);
  const test::Reference reference = solveReference(probe, kStiffness, planes);
  REQUIRE((solved.offset - reference.offset).norm() <= solved.error_bound + reference.error_bound);

  const Vec3 elsewhere(0.0030742, -0.00644263, 0);
  CHECK((elsewhere - solved.proxy).norm() > 1e-3);
  CHECK(smallestResidualNear(elsewhere, probe, planes) <
        smallestResidualNear(solved.proxy, probe, planes) - 0.1);
}

TEST_CASE("section 4.3: from 8 to 1,024 primitives the iterations of a balance at most double",
          "[paper]") {
  // An iteration of palpate or of Euler's method visits each primitive a fixed number of times. So
  // the work is the number of primitives times the iterations, and grows about linearly. The
  // strengths are inversely proportional to the number of primitives. So for any number, the proxy
  // sometimes sticks and sometimes slides.
  constexpr int kFew = 8;
  constexpr int kMany = static_cast<int>(kMaxPrimitives);
  const auto work = [](bool ours, bench::Family family, int count) {
    Random random(39);
    double sum = 0.0;
    for (int i = 0; i < 40; ++i) {
      bench::BalanceProblem p = bench::makeProblem(family, count, random);
      for (Primitive& primitive : p.primitives) primitive.strength *= 2.0 / count;
      const int iterations =
          ours ? solveProxy(p.probe, p.stiffness, p.primitives, p.start).iterations
               : methods::eulerAdaptive(p.probe, p.stiffness, p.primitives, p.start).iterations;
      sum += static_cast<double>(iterations) * count;
    }
    return sum / 40.0;
  };
  for (const auto family :
       {bench::Family::kRandom, bench::Family::kOnePoint, bench::Family::kPlanes}) {
    for (const bool ours : {true, false}) {
      const double few = work(ours, family, kFew);
      const double many = work(ours, family, kMany);
      std::cout << (ours ? "palpate" : "Euler") << ", " << bench::wordFor(family)
                << ": iterations at 8 primitives " << few / kFew << ", at 1,024 " << many / kMany
                << '\n';
      CHECK(many <= 2.0 * few * kMany / kFew);
    }
  }
}

}  // namespace palpate::paper_test
