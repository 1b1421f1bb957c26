#include "palpate/engine/balance/solver.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <limits>
#include <map>
#include <sstream>
#include <string>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "tests/support/counters.h"
#include "tests/support/problems.h"
#include "tests/support/random.h"
#include "tests/support/reference_solver.h"
#include "tests/support/source_dir.h"

namespace palpate::solver_test {
using palpate::bench::BalanceProblem;
using palpate::bench::Family;
using palpate::test::describe;
using palpate::test::Random;
using palpate::test::Reference;
using palpate::test::solveReference;

namespace {

constexpr double kStiffness = 500.0;

Primitive plane(const Vec3& position, const Vec3& normal, double strength) {
  return {PrimitiveKind::kPlane, position, normal.normalized(), strength};
}

}  // namespace

TEST_CASE("without primitives the proxy is at the probe", "[solver]") {
  const Vec3 probe(0.1, -0.2, 0.3);
  const SolveResult r = solveProxy(probe, kStiffness, {}, Vec3::Zero());
  CHECK(r.status == SolveStatus::kConverged);
  CHECK(r.proxy == probe);
  CHECK(r.error_bound < 1e-15);
}

TEST_CASE("a directed force moves the proxy by s/k", "[solver][eq8]") {
  const std::vector<Primitive> set{{PrimitiveKind::kForce, Vec3::Zero(), Vec3::UnitZ(), 2.0}};
  const SolveResult r = solveProxy(Vec3::Zero(), kStiffness, set, Vec3::Zero());
  CHECK((r.offset - Vec3(0, 0, 2.0 / kStiffness)).norm() < 1e-18);
  CHECK(r.solver == SolverKind::kClosedForm);
}

TEST_CASE("a point, line or plane holds the proxy until the probe is S/k away, then yields",
          "[solver][eq9][eq11][eq13]") {
  const PrimitiveKind kind =
      GENERATE(PrimitiveKind::kPoint, PrimitiveKind::kLine, PrimitiveKind::kPlane);
  const Vec3 q = Vec3(1, 2, 2) / 3.0;
  const Vec3 at(0.01, 0.02, 0.03);
  const Vec3 away = kind == PrimitiveKind::kLine ? Vec3(q.unitOrthogonal()) : Vec3(-q);
  const std::vector<Primitive> set{{kind, at, q, 1.0}};
  const double reach = 1.0 / kStiffness;
  for (const double depth : {0.0, 0.3 * reach, reach, 1.7 * reach, 20 * reach}) {
    CAPTURE(static_cast<int>(kind), depth);
    const Vec3 probe = at + depth * away;
    const SolveResult r = solveProxy(probe, kStiffness, set, probe);
    const double held = std::min(depth, reach);
    CHECK((r.offset + held * away).norm() < 1e-16);
    CHECK(r.iterations == 0);
    CHECK(r.error_bound < 1e-15);
  }
}

TEST_CASE("a one-sided plane exerts no force on a proxy in front of it", "[solver][eq12]") {
  const std::vector<Primitive> set{plane(Vec3::Zero(), Vec3::UnitX(), 3.0)};
  const Vec3 probe(1e-3, 5e-3, 0);
  CHECK(solveProxy(probe, kStiffness, set, probe).offset.norm() == 0.0);
}

TEST_CASE("every balance of every family converges, and its certificate holds",
          "[solver][balance]") {
  // docs/speed_accuracy.md reports a run with PALPATE_CASES=10000000.
  const long n = test::cases(100000);
  // Of each family, one in `every` cases is compared with the reference.
  const long every = std::max(1L, n / 1000);
  long over_goal = 0;
  std::map<Family, long> judged;
  int most = 0;
  double solves = 0.0;
  double worst_bound = 0.0;
  double worst_error = 0.0;
  Random random(11);
  for (long i = 0; i < n; ++i) {
    const Family family = bench::kFamilies[static_cast<std::size_t>(i) % bench::kFamilies.size()];
    const int count = 1 + random.integer(random.integer(4) == 0 ? 32 : 8);
    const BalanceProblem p = bench::makeProblem(family, count, random);
    const SolveResult r = solveProxy(p.probe, p.stiffness, p.primitives, random.inCube(1.0));
    const double reach = bench::reachOf(p);
    double largest = p.probe.lpNorm<Eigen::Infinity>();
    for (const Primitive& q : p.primitives) {
      largest = std::max(largest, q.position.lpNorm<Eigen::Infinity>());
    }
    const double allowed =
        std::max({1e-6 * reach, 1e-12, 8.0 * std::numeric_limits<double>::epsilon() * largest});
    const bool solved =
        r.status == SolveStatus::kConverged && r.error_bound <= allowed && r.iterations <= 60;
    if (!solved) {
      FAIL(bench::wordFor(family) << ": bound " << r.error_bound << " m, allowed " << allowed
                                  << ", " << r.iterations << " iterations: "
                                  << describe(p.probe, p.stiffness, p.primitives));
    }
    most = std::max(most, r.iterations);
    solves += r.iterations;
    over_goal += static_cast<long>(r.iterations > 25);
    worst_bound = std::max(worst_bound, r.error_bound / allowed);
    if (i / static_cast<long>(bench::kFamilies.size()) % every != 0) continue;
    ++judged[family];
    const Reference ref = solveReference(p.probe, p.stiffness, p.primitives);
    const double error = (r.offset - ref.offset).norm();
    worst_error = std::max(worst_error, error / allowed);
    if (error > r.error_bound + ref.error_bound) {
      FAIL(bench::wordFor(family) << ": farther from the reference (" << error
                                  << " m) than the bound " << r.error_bound << " + "
                                  << ref.error_bound << ": "
                                  << describe(p.probe, p.stiffness, p.primitives));
    }
  }
  long all_judged = 0;
  for (const auto& [family, count] : judged) all_judged += count;
  CHECK(judged.size() == bench::kFamilies.size());
  WARN(n << " problems, " << all_judged
         << " judged by the reference; failures 0; of what is allowed: "
         << "worst bound " << worst_bound << ", worst true error " << worst_error
         << "; iterations: average " << solves / static_cast<double>(n) << ", worst " << most
         << ", above 25: " << over_goal);
}

TEST_CASE("the stored difficult balances converge within their error bounds", "[solver]") {
  std::ifstream file(test::sourceDir() + "/tests/engine/hard_balances.txt");
  REQUIRE(file.is_open());
  int problems = 0;
  int most = 0;
  for (std::string line; std::getline(file, line);) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream numbers(line);
    double k = 0.0;
    Vec3 probe;
    REQUIRE(numbers >> k >> probe.x() >> probe.y() >> probe.z());
    std::vector<Primitive> set;
    for (int kind = 0; numbers >> kind;) {
      Primitive p;
      p.kind = static_cast<PrimitiveKind>(kind);
      REQUIRE(numbers >> p.position.x() >> p.position.y() >> p.position.z() >> p.direction.x() >>
              p.direction.y() >> p.direction.z() >> p.strength);
      set.push_back(p);
    }
    ++problems;
    const SolveResult r = solveProxy(probe, k, set, probe);
    const Reference ref = solveReference(probe, k, set);
    CAPTURE(describe(probe, k, set), r.error_bound, r.iterations);
    CHECK(r.status == SolveStatus::kConverged);
    CHECK((r.offset - ref.offset).norm() <= r.error_bound + ref.error_bound);
    most = std::max(most, r.iterations);
  }
  CHECK(problems >= 30);
  WARN(problems << " hard balances, at most " << most << " solves");
}

TEST_CASE("the error bound covers the rounding for a plane and a nearly parallel plane or line",
          "[solver]") {
  Random random(16);
  for (int i = 0; i < 2000; ++i) {
    const Vec3 at = random.inCube(2e-3);
    const Vec3 q = random.direction();
    const double tilt = random.logUniform(1e-12, 1e-3);
    const Vec3 other = (q + tilt * random.inCube(1.0)).normalized();
    std::vector<Primitive> set{plane(at, q, 1.0), plane(at, other, 1.0)};
    // The line is tilted against the plane by an angle of about `tilt` [rad].
    if (i % 2 == 0) {
      set[1].kind = PrimitiveKind::kLine;
      set[1].direction = (q.unitOrthogonal() + tilt * random.inCube(1.0)).normalized();
    }
    const Vec3 probe = at - random.uniform(0.0, 2e-3) * q;
    const SolveResult r = solveProxy(probe, kStiffness, set, probe);
    const Reference ref = solveReference(probe, kStiffness, set);
    if ((r.offset - ref.offset).norm() > r.error_bound + ref.error_bound) {
      FAIL((r.offset - ref.offset).norm()
           << " m, bound " << r.error_bound << " + " << ref.error_bound << ": "
           << describe(probe, kStiffness, set));
    }
  }
}

TEST_CASE("the result of a solve that is stopped early is within its error bound", "[solver]") {
  Random random(29);
  for (long i = 0; i < test::cases(1000); ++i) {
    const Family family = bench::kFamilies[static_cast<std::size_t>(i) % bench::kFamilies.size()];
    const BalanceProblem p = bench::makeProblem(family, 3 + random.integer(6), random);
    const Reference ref = solveReference(p.probe, p.stiffness, p.primitives);
    for (int most = 1; most <= 6; ++most) {
      SolverParams params;
      params.tolerance = random.logUniform(1e-4, 1.0);
      params.max_iterations = most;
      const SolveResult r = solveProxy(p.probe, p.stiffness, p.primitives, p.start, params);
      CAPTURE(bench::wordFor(family), most, params.tolerance,
              describe(p.probe, p.stiffness, p.primitives));
      REQUIRE((r.offset - ref.offset).norm() <= r.error_bound + ref.error_bound);
    }
  }
}

TEST_CASE("directions whose length differs from 1 by less than 1e-6 count as unit vectors",
          "[solver]") {
  Random random(17);
  for (int i = 0; i < 500; ++i) {
    std::vector<Primitive> set;
    std::vector<Primitive> exact;
    for (int j = 0; j < 3; ++j) {
      exact.push_back(random.primitive());
      set.push_back(exact.back());
      set.back().direction *= 1.0 + 0.99e-6 * random.uniform(-1.0, 1.0);
    }
    const Vec3 probe = random.inCube(5e-3);
    const SolveResult a = solveProxy(probe, kStiffness, set, probe);
    const SolveResult b = solveProxy(probe, kStiffness, exact, probe);
    CAPTURE(describe(probe, kStiffness, set));
    CHECK((a.offset - b.offset).norm() <= a.error_bound + b.error_bound);
    // For a set of directed forces only, the error bound covers only rounding.
    const std::vector<Primitive> off{
        {PrimitiveKind::kForce, Vec3::Zero(), {0, 0, 1.0 + 0.99e-6}, 1.0}};
    const SolveResult r = solveProxy(Vec3::Zero(), kStiffness, off, Vec3::Zero());
    CHECK(std::abs(r.offset.z() - 1.0 / kStiffness) <= r.error_bound);
  }
}

TEST_CASE("a set with the largest number of primitives of any family converges",
          "[solver][balance]") {
  Random random(12);
  for (const Family family : bench::kFamilies) {
    const BalanceProblem p = bench::makeProblem(family, static_cast<int>(kMaxPrimitives), random);
    const SolveResult r = solveProxy(p.probe, p.stiffness, p.primitives, p.start);
    CAPTURE(bench::wordFor(family), r.error_bound, r.iterations);
    CHECK(r.status == SolveStatus::kConverged);
    CHECK(r.iterations <= 60);
  }
}

TEST_CASE("orthogonal sets are solved in closed form, to rounding", "[solver]") {
  Random random(13);
  for (int i = 0; i < 600; ++i) {
    const BalanceProblem p = bench::makeProblem(Family::kOrthogonal, 1 + i % 3, random);
    const SolveResult r = solveProxy(p.probe, p.stiffness, p.primitives, p.start);
    const Reference ref = solveReference(p.probe, p.stiffness, p.primitives);
    CAPTURE(describe(p.probe, p.stiffness, p.primitives));
    REQUIRE(r.solver == SolverKind::kClosedForm);
    REQUIRE(r.error_bound <= 1e-12 * bench::reachOf(p) + 1e-16);
    REQUIRE((r.offset - ref.offset).norm() <= r.error_bound + ref.error_bound);
  }
}

TEST_CASE("nearly orthogonal sets of primitives are solved within their error bounds", "[solver]") {
  Random random(14);
  for (int i = 0; i < 600; ++i) {
    BalanceProblem p = bench::makeProblem(Family::kOrthogonal, 2 + i % 2, random);
    const double tilt = random.logUniform(1e-14, 1e-2);
    for (Primitive& q : p.primitives) {
      q.direction = (q.direction + tilt * random.inCube(1.0)).normalized();
    }
    const SolveResult r = solveProxy(p.probe, p.stiffness, p.primitives, p.start);
    const Reference ref = solveReference(p.probe, p.stiffness, p.primitives);
    if ((r.offset - ref.offset).norm() > r.error_bound + ref.error_bound) {
      FAIL(tilt << ": " << describe(p.probe, p.stiffness, p.primitives));
    }
  }
}

namespace {

/// A hand that moves randomly about primitives. If `follow` is true, the primitives move with the
/// proxy and turn slowly, as the primitives of modes do. Otherwise the primitives are fixed.
struct Walk {
  Walk(int count, bool follow, std::uint64_t seed) : follows(follow), random(seed) {
    for (int i = 0; i < count; ++i) {
      set.push_back(random.primitive());
      if (follows) set.back().position.setZero();
    }
  }
  void step(const Vec3& proxy) {
    velocity += 1e-5 * random.inCube(1.7) - 1e-3 * velocity - 2e-3 * probe;
    probe += velocity;
    for (Primitive& p : set) {
      if (!follows) break;
      p.position = proxy;
      p.direction = (p.direction + 1e-3 * random.inCube(1.7)).normalized();
    }
  }
  bool follows;
  Random random;
  std::vector<Primitive> set;
  Vec3 probe = Vec3::Zero();
  Vec3 velocity = Vec3::Zero();
};

}  // namespace

TEST_CASE(
    "a warm start gives the cold start's balance, in at most 6 iterations on average along a path",
    "[solver][balance]") {
  const bool follows = GENERATE(false, true);
  for (const int count : {2, 3, 4, 8, 32}) {
    double warm_solves = 0.0;
    double cold_solves = 0.0;
    long ticks = 0;
    for (std::uint64_t seed = 0; seed < 20; ++seed) {
      Walk walk(count, follows, seed);
      WarmStart warm;
      Vec3 proxy = Vec3::Zero();
      for (int t = 0; t < 300; ++t, ++ticks) {
        walk.step(proxy);
        const SolveResult a = solveProxy(walk.probe, kStiffness, walk.set, proxy, {}, &warm);
        const SolveResult b = solveProxy(walk.probe, kStiffness, walk.set, proxy);
        if (a.status != SolveStatus::kConverged ||
            (a.offset - b.offset).norm() > a.error_bound + b.error_bound) {
          FAIL(a.error_bound << ' ' << b.error_bound << ' '
                             << describe(walk.probe, kStiffness, walk.set));
        }
        warm_solves += a.iterations;
        cold_solves += b.iterations;
        proxy = a.proxy;
      }
    }
    WARN(count << (follows ? " primitives placed at the proxy" : " primitives at rest")
               << ": average iterations " << warm_solves / static_cast<double>(ticks) << " warm, "
               << cold_solves / static_cast<double>(ticks) << " cold");
    CHECK(warm_solves <= 6.0 * static_cast<double>(ticks));
    CHECK(warm_solves < cold_solves);
  }
}

TEST_CASE("a warm start from random values converges to the cold start's balance", "[solver]") {
  Random random(15);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (int i = 0; i < 3000; ++i) {
    const BalanceProblem p = bench::makeProblem(Family::kRandom, 1 + random.integer(8), random);
    WarmStart warm;
    warm.count = p.primitives.size();
    warm.motion = random.inCube(i % 3 == 0 ? 1e3 : 1e-3);
    for (Vec3& z : warm.multipliers) z = random.inCube(i % 5 == 0 ? 1e9 : 1.0);
    if (i % 7 == 0) warm.multipliers[0].setConstant(nan);
    if (i % 11 == 0) warm.motion.setConstant(nan);
    const SolveResult a =
        solveProxy(p.probe, p.stiffness, p.primitives, random.inCube(1.0), {}, &warm);
    const SolveResult b = solveProxy(p.probe, p.stiffness, p.primitives, p.start);
    if (a.status != SolveStatus::kConverged ||
        !((a.offset - b.offset).norm() <= a.error_bound + b.error_bound)) {
      FAIL(a.error_bound << ' ' << b.error_bound << ' '
                         << describe(p.probe, p.stiffness, p.primitives));
    }
  }
}

TEST_CASE("rotating and shifting the problem rotates and shifts the balance", "[solver]") {
  Random random(5);
  for (int i = 0; i < 300; ++i) {
    const Mat3 R = Eigen::AngleAxisd(random.uniform(-3, 3), random.direction()).toRotationMatrix();
    const Vec3 t = random.inCube(0.1);
    std::vector<Primitive> set;
    std::vector<Primitive> turned;
    double sum = 0.0;
    for (int j = 0; j < 4; ++j) {
      set.push_back(random.primitive());
      turned.push_back(set.back());
      turned.back().position = R * turned.back().position + t;
      turned.back().direction = (R * turned.back().direction).normalized();
      sum += set.back().strength;
    }
    const Vec3 probe = random.inCube(5e-3);
    const SolveResult a = solveProxy(probe, kStiffness, set, probe);
    const SolveResult b = solveProxy(R * probe + t, kStiffness, turned, probe);
    CAPTURE(describe(probe, kStiffness, set));
    // The extra 1e-16 m covers the rounding of the rotated problem's coordinates of 0.1 m.
    CHECK((R * a.offset - b.offset).norm() <= a.error_bound + b.error_bound + 1e-16);
  }
}

TEST_CASE("zero-strength primitives do not change the balance", "[solver]") {
  Random random(6);
  for (int i = 0; i < 300; ++i) {
    std::vector<Primitive> set{random.primitive(), random.primitive()};
    const Vec3 probe = random.inCube(5e-3);
    const SolveResult a = solveProxy(probe, kStiffness, set, probe);
    set.push_back(random.primitive());
    set.back().strength = 0.0;
    const SolveResult b = solveProxy(probe, kStiffness, set, probe);
    CHECK(a.offset == b.offset);
    CHECK(a.error_bound == b.error_bound);
  }
}

TEST_CASE("the error bound covers the rounding of forces that cancel", "[solver]") {
  Random random(23);
  for (int i = 0; i < 300; ++i) {
    std::vector<Primitive> set;
    const int pairs = i % 100 == 0 ? 500 : 3;
    for (int j = 0; j < pairs; ++j) {
      Primitive p = random.primitive();
      p.kind = PrimitiveKind::kForce;
      p.strength = random.uniform(7e3, 1e4);
      set.push_back(p);
      p.direction = -p.direction;
      set.push_back(p);
    }
    const SolveResult r = solveProxy(Vec3::Zero(), 1.0, set, Vec3::Zero());
    REQUIRE(r.offset.norm() <= r.error_bound);
  }
}

TEST_CASE("the solver gives bitwise equal results for equal problems and equal earlier balances",
          "[solver]") {
  Random random(8);
  for (const Family family : bench::kFamilies) {
    WarmStart one;
    WarmStart other;
    BalanceProblem p = bench::makeProblem(family, 1 + random.integer(20), random);
    for (int tick = 0; tick < 10; ++tick) {
      p.probe += 1e-5 * random.direction();
      const SolveResult a = solveProxy(p.probe, p.stiffness, p.primitives, p.start, {}, &one);
      const SolveResult b = solveProxy(p.probe, p.stiffness, p.primitives, p.start, {}, &other);
      const SolveResult cold = solveProxy(p.probe, p.stiffness, p.primitives, p.start);
      const SolveResult elsewhere = solveProxy(p.probe, p.stiffness, p.primitives, Vec3::Ones());
      CAPTURE(bench::wordFor(family), describe(p.probe, p.stiffness, p.primitives));
      REQUIRE(a.offset == b.offset);
      REQUIRE(a.error_bound == b.error_bound);
      REQUIRE(a.iterations == b.iterations);
      REQUIRE(cold.offset == elsewhere.offset);
      p.start = a.proxy;
    }
  }
}

TEST_CASE("opposed planes hold the proxy in a slot", "[solver]") {
  const double width = GENERATE(0.0, 1e-6, 1e-3);
  const std::vector<Primitive> set{plane({0, 0, 0}, {0, 0, 1}, 2.0),
                                   plane({0, 0, width}, {0, 0, -1}, 2.0)};
  for (const double z : {-1e-3, 0.0, 0.5 * width, width, 2e-3}) {
    const Vec3 probe(1e-3, 2e-3, z);
    std::array<Vec3, 2> forces;
    const SolveResult r = solveProxy(probe, kStiffness, set, probe, {}, nullptr, forces);
    CAPTURE(width, z);
    CHECK(std::abs(r.proxy.z() - std::clamp(z, 0.0, width)) <= r.error_bound);
    CHECK(r.error_bound <= 1e-6 * 4.0 / kStiffness);
    // The plane against which the spring presses the proxy bears the spring's force. The other
    // plane bears no force.
    const double spring = kStiffness * (r.proxy.z() - z);
    const double unknown = kStiffness * r.error_bound + 1e-12;
    CHECK(std::abs(forces[0].z() - std::max(0.0, spring)) <= unknown);
    CHECK(std::abs(forces[1].z() - std::min(0.0, spring)) <= unknown);
  }
}

TEST_CASE("planes alone are balanced by pivoting to a twentieth of the tolerance", "[solver]") {
  // Newton's method would stop at an error bound of 1e-6 S/k. Pivoting is exact except for
  // rounding.
  for (const std::size_t count : {3, 8, 64, 1024}) {
    CAPTURE(count);
    Random random(21);
    for (int i = 0; i < (count == 1024 ? 20 : 200); ++i) {
      const BalanceProblem p = bench::makeProblem(Family::kPlanes, static_cast<int>(count), random);
      const SolveResult r = solveProxy(p.probe, p.stiffness, p.primitives, p.start);
      double strength = 0.0;
      for (const Primitive& primitive : p.primitives) strength += primitive.strength;
      REQUIRE(r.status == SolveStatus::kConverged);
      REQUIRE(r.error_bound <= 5e-8 * strength / p.stiffness);
      REQUIRE(r.iterations <= 40);
      // The same pivoting steps reach a much smaller error bound.
      SolverParams fine;
      fine.tolerance = count == 1024 ? 1e-8 : 1e-10;
      const SolveResult exact = solveProxy(p.probe, p.stiffness, p.primitives, p.start, fine);
      REQUIRE(exact.status == SolveStatus::kConverged);
      REQUIRE(exact.error_bound <= fine.tolerance * strength / p.stiffness);
      REQUIRE(exact.iterations == r.iterations);
    }
  }
  // Three planes cross in one point, and a slot of two opposite planes lies along each of them. The
  // set contains all these planes three times. The planes can hold the first load. At the last
  // load, all planes that bear load yield.
  const std::vector<Vec3> normals{{1, 0, 0}, {0.6, 0.8, 0}, {0.2, 0.3, 0.9}};
  for (const double load : {1e-3, 4e-3, 0.1}) {
    std::vector<Primitive> set;
    for (int again = 0; again < 3; ++again) {
      for (const Vec3& normal : normals) {
        set.push_back(plane({1e-3, 0, 0}, normal, 0.3));
        set.push_back(plane({1e-3, 0, 0}, normal, 0.1));
        set.push_back(plane({1e-3, 0, 0}, -normal, 0.1));
      }
    }
    const Vec3 probe = Vec3(1e-3, 0, 0) - load * Vec3(0.5, 0.6, 0.7);
    const SolveResult r = solveProxy(probe, kStiffness, set, probe);
    const Reference exact = solveReference(probe, kStiffness, set);
    CAPTURE(load);
    CHECK(r.status == SolveStatus::kConverged);
    CHECK((r.offset - exact.offset).norm() <= r.error_bound + exact.error_bound);
  }
}

TEST_CASE(
    "a plane and one other primitive are balanced even if their kinks are very near each other",
    "[solver]") {
  Random random(22);
  for (long i = 0; i < test::cases(20000); ++i) {
    // A surface with viscosity places similar primitives: a point at the proxy, and a plane near
    // the point.
    const Vec3 at = random.inCube(5e-2);
    const double apart = random.integer(10) == 0 ? 0.0 : random.logUniform(1e-16, 1e-2);
    Primitive other = random.primitive();
    if (other.kind == PrimitiveKind::kForce) other.kind = PrimitiveKind::kPoint;
    other.position = at;
    const Vec3 normal = random.direction();
    const std::vector<Primitive> set{other, plane(at + apart * normal, normal, 1.5)};
    const Vec3 probe = at + random.inCube(2e-3);
    const SolveResult r = solveProxy(probe, kStiffness, set, probe);
    if (r.status != SolveStatus::kConverged) FAIL(describe(probe, kStiffness, set));
    if (i % 40 != 0) continue;
    const Reference ref = solveReference(probe, kStiffness, set);
    if ((r.offset - ref.offset).norm() > r.error_bound + ref.error_bound) {
      FAIL(r.error_bound << " " << ref.error_bound << " " << describe(probe, kStiffness, set));
    }
  }
}

TEST_CASE("a set of 1,024 primitives is balanced and a larger set is refused", "[solver]") {
  Random random(9);
  std::vector<Primitive> set;
  for (std::size_t j = 0; j < kMaxPrimitives; ++j) set.push_back(random.primitive());
  const SolveResult r = solveProxy(Vec3::Zero(), kStiffness, set, Vec3::Zero());
  CHECK(r.status == SolveStatus::kConverged);
  set.push_back(random.primitive());
  CHECK(solveProxy(Vec3::Zero(), kStiffness, set, Vec3::Zero()).status == SolveStatus::kBadInput);
}

TEST_CASE("bad input to the solver gives an error status and leaves the proxy at the start",
          "[solver]") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  const Primitive good = plane({0, 0, 0}, {0, 0, 1}, 1.0);
  const Vec3 start(1, 2, 3);
  const auto status = [&](const Vec3& probe, double k, const Primitive& p) {
    const SolveResult r = solveProxy(probe, k, std::vector<Primitive>{p, good}, start);
    if (r.status == SolveStatus::kBadInput) CHECK(r.proxy == start);
    return r.status;
  };
  CHECK(status(Vec3::Zero(), 500, good) == SolveStatus::kConverged);
  CHECK(status({nan, 0, 0}, 500, good) == SolveStatus::kBadInput);
  CHECK(status({0, inf, 0}, 500, good) == SolveStatus::kBadInput);
  for (const double k : {0.0, -1.0, nan, inf}) {
    CHECK(status(Vec3::Zero(), k, good) == SolveStatus::kBadInput);
  }
  for (const double s : {-1.0, nan, inf}) {
    Primitive p = good;
    p.strength = s;
    CHECK(status(Vec3::Zero(), 500, p) == SolveStatus::kBadInput);
  }
  for (const Vec3& q : {Vec3(0, 0, 0), Vec3(0, 0, 1.0 + 1e-5), Vec3(nan, 0, 1)}) {
    Primitive p = good;
    p.direction = q;
    CHECK(status(Vec3::Zero(), 500, p) == SolveStatus::kBadInput);
  }
  Primitive far = good;
  far.position = {0, 0, inf};
  CHECK(status(Vec3::Zero(), 500, far) == SolveStatus::kBadInput);
}

TEST_CASE("extreme but valid numbers give a finite balance with a valid error bound", "[solver]") {
  Random random(21);
  for (int i = 0; i < 4000; ++i) {
    std::vector<Primitive> set;
    const int count = 1 + random.integer(4);
    const double reach = random.logUniform(1e-9, 1e4);
    double sum = 0.0;
    for (int j = 0; j < count; ++j) {
      Primitive p = random.primitive();
      p.position = random.inCube(reach);
      p.strength = random.integer(10) == 0 ? 5e-324 : random.logUniform(1e-9, 1e4);
      sum += p.strength;
      set.push_back(p);
    }
    const double k = random.logUniform(1.0, 1e5);
    const Vec3 probe = random.inCube(reach);
    const SolveResult r = solveProxy(probe, k, set, probe);
    CAPTURE(describe(probe, k, set));
    REQUIRE(r.status != SolveStatus::kBadInput);
    REQUIRE(r.offset.allFinite());
    REQUIRE(r.status == SolveStatus::kConverged);
    REQUIRE(r.offset.norm() <= sum / k * (1 + 1e-9) + r.error_bound);
    if (i % 20 != 0) continue;
    const Reference ref = solveReference(probe, k, set);
    REQUIRE((r.offset - ref.offset).norm() <= r.error_bound + ref.error_bound);
  }
}

TEST_CASE("the solver does not allocate, lock or throw", "[solver][realtime]") {
  Random random(10);
  std::vector<Primitive> set;
  for (int j = 0; j < 40; ++j) set.push_back(random.primitive());
  WarmStart warm;
  const test::CountScope scope;
  for (int count : {0, 1, 2, 8, 40}) {
    const auto some = std::span(set).first(static_cast<std::size_t>(count));
    (void)solveProxy(Vec3(1e-3, 0, 0), kStiffness, some, Vec3::Zero());
    for (int tick = 0; tick < 3; ++tick) {
      (void)solveProxy(Vec3(1e-3, 1e-5 * tick, 0), kStiffness, some, Vec3::Zero(), {}, &warm);
    }
  }
  const test::Counts counts = test::CountScope::counts();
  CHECK(counts.allocations == 0);
  CHECK(counts.locks == 0);
  CHECK(counts.exceptions == 0);
}

}  // namespace palpate::solver_test
