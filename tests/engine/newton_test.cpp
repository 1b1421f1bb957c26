/// Tests Newton's step of the balance: its convergence, and its results on curved surfaces.
#include "palpate/engine/balance/newton.h"

#include <cmath>
#include <functional>
#include <vector>

#include <Eigen/Dense>
#include <catch2/catch.hpp>

#include "palpate/engine/balance/solver.h"
#include "tests/support/random.h"

namespace palpate::newton_test {

namespace {

constexpr double kStiffness = 500.0;

/// A quadric V = 0. A Surface has one quadric for its values and another one for the normals of its
/// planes. Trilinear volumes have the same property: their normals are not the gradients of their
/// interpolated values.
struct Quadric {
  double value = 0.0;
  Vec3 slope = Vec3::Zero();
  Mat3 curve = Mat3::Zero();

  [[nodiscard]] double at(const Vec3& x) const {
    return value + x.dot(slope) + 0.5 * x.dot(curve * x);
  }
  [[nodiscard]] Vec3 gradient(const Vec3& x) const { return slope + curve * x; }
};
struct Surface {
  Quadric value;
  Quadric normal;
  double strength = 0.0;
};

/// The residual of the balance with the primitives that were read at x, and Newton's step from x.
struct Reading {
  Vec3 residual;
  Vec3 step;
  std::vector<Load> loads;
};
Reading readAt(const Vec3& x, const Vec3& probe, const std::vector<Surface>& surfaces,
               const std::vector<Primitive>& others = {}) {
  std::vector<Primitive> primitives = others;
  std::vector<Varying> varying;
  for (const Surface& surface : surfaces) {
    const Vec3 g = surface.normal.gradient(x);
    const Vec3 n = g.normalized();
    const Vec3 c = surface.value.gradient(x);
    const double off = surface.value.at(x);
    varying.push_back({primitives.size(),
                       (Mat3::Identity() - n * n.transpose()) * surface.normal.curve / g.norm(),
                       Vec3::Zero(), c.normalized(), off / c.norm(), true});
    primitives.push_back({PrimitiveKind::kPlane, x - off / c.dot(n) * n, n, surface.strength});
  }
  std::vector<Vec3> forces(primitives.size());
  SolverParams params;
  params.tolerance = 1e-12;
  const SolveResult solved = solveProxy(probe, kStiffness, primitives, x, params, nullptr, forces);
  Reading out;
  out.residual = solved.proxy - x;
  out.step = newtonStep(solved.proxy, x, x, kStiffness, primitives, forces, varying);
  for (std::size_t i = 0; i < primitives.size(); ++i)
    out.loads.push_back(loadOf(primitives[i], forces[i]));
  return out;
}

/// Returns a surface near the origin. The elements of its curvature matrix are up to `bend` [1/mm].
/// The normals of its planes are tilted, and have a curvature matrix of the same size.
Surface anySurface(test::Random& random, const Vec3& outwards, double bend, double strength) {
  const auto symmetric = [&] {
    Mat3 m;
    m << random.inCube(1.0), random.inCube(1.0), random.inCube(1.0);
    return Mat3(0.5 * bend * 1e3 * (m + m.transpose()));
  };
  Surface surface;
  surface.strength = strength;
  surface.value = {random.uniform(-2e-5, 2e-5), outwards, symmetric()};
  surface.normal = {0.0, outwards + random.inCube(0.4), symmetric()};
  return surface;
}

/// A run of Newton's method: |residual| of each step [m], and the last reading.
struct Course {
  std::vector<double> residuals;
  Reading last;
};
Course converge(Vec3 x, const Vec3& probe, const std::vector<Surface>& surfaces,
                const std::vector<Primitive>& others = {}) {
  Course course;
  for (int i = 0; i < 12; ++i) {
    course.last = readAt(x, probe, surfaces, others);
    course.residuals.push_back(course.last.residual.norm());
    x += course.last.step;
  }
  return course;
}

}  // namespace

TEST_CASE("Newton's residual falls quadratically on a fillet on which Picard's iteration diverges",
          "[newton]") {
  // A fillet of radius 0.3 mm with the hand 2 mm deep: Picard's iteration multiplies the error by
  // -6.7.
  const double radius = 3e-4;
  Surface fillet;
  fillet.strength = 10.0;
  // The free side is inside the cylinder x^2 + (z - r)^2 < r^2.
  fillet.value = {0.0, Vec3::UnitZ(), -Vec3(1.0, 0.0, 1.0).asDiagonal().toDenseMatrix() / radius};
  fillet.normal = fillet.value;
  const Vec3 probe(2e-5, 1e-5, -2e-3);
  Vec3 picard(5e-6, 0, 0);
  const double before = readAt(picard, probe, {fillet}).residual.norm();
  for (int i = 0; i < 3; ++i) picard += readAt(picard, probe, {fillet}).residual;
  CHECK(readAt(picard, probe, {fillet}).residual.norm() > 3.0 * before);
  const Course newton = converge(Vec3(5e-6, 0, 0), probe, {fillet});
  CHECK(newton.residuals.front() > 1e-6);
  CHECK(newton.residuals[4] < 1e-12);
}

TEST_CASE("Newton's step converges quadratically on up to three surfaces that hold the proxy",
          "[newton]") {
  test::Random random(3);
  const long count = test::cases(2000);
  long held = 0;
  for (long n = 0; n < count; ++n) {
    const int many = 1 + random.integer(3);
    std::vector<Surface> surfaces;
    std::vector<Vec3> out;
    for (int i = 0; i < many; ++i) {
      Vec3 way = Vec3::Unit(i) + random.inCube(0.3);
      out.push_back(way.normalized());
      surfaces.push_back(anySurface(random, out.back(), 0.3, 20.0));
    }
    Vec3 probe = Vec3::Zero();
    for (const Vec3& way : out) probe -= random.uniform(5e-4, 1e-3) * way;
    std::vector<Primitive> others;
    if (random.integer(3) == 0) {
      others.push_back({PrimitiveKind::kForce, Vec3::Zero(), random.direction(), 0.1});
    }
    if (random.integer(3) == 0) {
      others.push_back({PrimitiveKind::kLine, 2e-5 * random.direction(), random.direction(), 0.05});
    }
    const Course course = converge(random.inCube(2e-5), probe, surfaces, others);
    const bool all =
        std::all_of(course.last.loads.begin() + static_cast<std::ptrdiff_t>(others.size()),
                    course.last.loads.end(), [](Load load) { return load == Load::kHeld; });
    // Skips cases in which a surface does not hold, and those that do not converge, near a ridge.
    if (!all || course.residuals[8] > 1e-9) continue;
    ++held;
    for (std::size_t i = 3; i + 1 < course.residuals.size(); ++i) {
      const double e = course.residuals[i];
      const double next = course.residuals[i + 1];
      CAPTURE(n, many, i, e, next);
      REQUIRE((next <= 2e4 * e * e || next <= 1e-11));
    }
  }
  CHECK(held > 8 * count / 10);
}

TEST_CASE("Newton's step converges where a surface yields and the direction of the balance changes",
          "[newton]") {
  // The surface has yielded, so it pushes the proxy with its strength s along its normal n. With
  // the hand at h, the balance is x = h + s/k n(x).
  test::Random random(4);
  const long count = test::cases(2000);
  long gave = 0;
  long converged = 0;
  for (long n = 0; n < count; ++n) {
    Surface surface = anySurface(random, random.direction(), 0.5, 0.3);
    surface.value.value = 5e-3;  // the probe is far behind the surface
    const Vec3 out = surface.value.slope;
    const Vec3 probe = -1e-2 * out;
    const Course course = converge(probe + 5e-4 * out, probe, {surface});
    // Skips quadrics that curve back, so that the surface does not yield.
    if (course.last.loads[0] != Load::kYielding) continue;
    ++gave;
    converged += course.residuals[8] < 1e-11 ? 1 : 0;
  }
  CHECK(gave > count / 2);
  CHECK(converged >= gave - gave / 50);  // in the other cases, the quadric curves back
}

TEST_CASE("Newton's step follows the residual on a convex edge and equals it without surfaces",
          "[newton]") {
  // The hand is 3 mm deep in a cylinder of radius 1 mm, and 10 um to one side of the ridge. The
  // nearest point of the surface is on the same side.
  Surface edge;
  edge.strength = 10.0;
  edge.value = {0.0, Vec3::UnitZ(), Vec3(1.0, 0.0, 0.0).asDiagonal().toDenseMatrix() / 1e-3};
  edge.normal = edge.value;
  const Vec3 probe(1e-5, 0, -3e-3);
  const Reading top = readAt(Vec3(2e-6, 0, 0), probe, {edge});
  // The hand is beyond the centre of curvature, yet the step must go in the residual's direction.
  CHECK(top.step.x() * top.residual.x() > 0.0);
  CHECK(std::abs(top.step.x()) < 30.0 * std::abs(top.residual.x()));
  const std::vector<Primitive> drag{{PrimitiveKind::kPoint, Vec3::Zero(), Vec3::UnitX(), 0.2}};
  const std::vector<Vec3> forces{Vec3(0.1, 0.0, 0.0)};
  const Vec3 residual(1e-4, 2e-4, 3e-4);
  const Vec3 x = Vec3::Zero();
  CHECK(newtonStep(residual, x, x, kStiffness, drag, forces, {}) == residual);
}

}  // namespace palpate::newton_test
