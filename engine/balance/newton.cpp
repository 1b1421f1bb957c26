#include "palpate/engine/balance/newton.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Dense>

namespace palpate {

namespace {

/// Orthonormal directions, with the required length of the step along each [m].
struct Rows {
  std::array<Vec3, 3> direction;
  std::array<double, 3> way{};
  std::size_t count = 0;

  /// Adds the row q.step = length [m]. Returns false and adds no row if there are three rows, or if
  /// at most 2 % of q is outside the span of the earlier rows.
  bool add(Vec3 q, double length) noexcept {
    for (std::size_t i = 0; i < count; ++i) {
      const double share = q.dot(direction[i]);
      q -= share * direction[i];
      length -= share * way[i];
    }
    constexpr double kAside = 0.02;
    const double norm = q.norm();
    if (count == 3 || !(norm > kAside)) return false;
    direction[count] = q / norm;
    way[count++] = length / norm;
    return true;
  }
  [[nodiscard]] Vec3 step() const noexcept {
    Vec3 sum = Vec3::Zero();
    for (std::size_t i = 0; i < count; ++i) sum += way[i] * direction[i];
    return sum;
  }
};

/// The constraints of the primitives that hold. `forces` contains the directions of their forces,
/// and `places` the steps that stay on them.
struct Held {
  Rows forces;
  Rows places;

  void take(const Vec3& q, const Vec3& across, double way, double way_of_balance) noexcept {
    if (!forces.add(q, way_of_balance)) return;
    if (!places.add(across, way)) (void)places.add(q, way_of_balance);
  }
};

Held heldBy(const Vec3& residual, std::span<const Primitive> primitives,
            std::span<const Vec3> forces, std::span<const Varying> varying) noexcept {
  Held held;
  auto varies = varying.begin();
  const auto stays = [&](const Vec3& q) { held.take(q, q, q.dot(residual), q.dot(residual)); };
  for (std::size_t i = 0; i < primitives.size() && held.forces.count < 3; ++i) {
    while (varies != varying.end() && varies->index < i) ++varies;
    const Primitive& primitive = primitives[i];
    if (primitive.kind == PrimitiveKind::kForce) continue;
    if (loadOf(primitive, forces[i]) != Load::kHeld) continue;
    if (primitive.kind == PrimitiveKind::kPlane) {
      const Vec3& n = primitive.direction;
      if (varies != varying.end() && varies->index == i && !varies->across.isZero(0.0)) {
        held.take(n, varies->across, -varies->height, n.dot(residual));
      } else {
        stays(n);
      }
    } else if (primitive.kind == PrimitiveKind::kLine) {
      const Vec3 across = primitive.direction.unitOrthogonal();
      stays(across);
      stays(primitive.direction.cross(across));
    } else {
      for (int a = 0; a < 3; ++a) stays(Vec3::Unit(a));
    }
  }
  if (held.places.count < held.forces.count) held.places = held.forces;
  return held;
}

constexpr double kFloor = 0.05;  // least magnitude of an eigenvalue in solveFree()

/// Returns x = S^-1 b if the real parts of S's eigenvalues are above kFloor; for N = 3, if those of
/// its symmetric part are, which suffices. S is not symmetric where n and c differ, and a balance
/// is stable if dx/dt = -S x decays, which these real parts decide. Otherwise the balance is a
/// ridge (newton.h), and the step leads down from it, by the magnitudes of the eigenvalues of the
/// symmetric part, each at least kFloor.
template <int N>
Eigen::Matrix<double, N, 1> solveFree(const Eigen::Matrix<double, N, N>& S,
                                      const Eigen::Matrix<double, N, 1>& b) noexcept {
  using Vector = Eigen::Matrix<double, N, 1>;
  if constexpr (N == 1) {
    return b / std::max(std::abs(S(0, 0)), kFloor);
  } else {
    if constexpr (N == 2) {
      const double det = S(0, 0) * S(1, 1) - S(0, 1) * S(1, 0);
      const double trace = S(0, 0) + S(1, 1);
      // The trace and the determinant of S - kFloor I are positive: for any real S, this means that
      // both real parts are above the floor.
      if (trace > 2.0 * kFloor && det > kFloor * (trace - kFloor)) {
        return Vector(S(1, 1) * b[0] - S(0, 1) * b[1], S(0, 0) * b[1] - S(1, 0) * b[0]) / det;
      }
    }
    if constexpr (N == 3) {
      // If the leading minors are positive, all eigenvalues of the symmetric part are above the
      // floor (Sylvester).
      const Mat3 above = 0.5 * (S + S.transpose()) - kFloor * Mat3::Identity();
      const bool stable = above(0, 0) > 0.0 &&
                          above(0, 0) * above(1, 1) > above(0, 1) * above(1, 0) &&
                          above.determinant() > 0.0;
      if (stable) return S.inverse() * b;
    }
    Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, N, N>> ridges;
    ridges.computeDirect(0.5 * (S + S.transpose()));
    Vector x = Vector::Zero();
    for (int i = 0; i < N; ++i) {
      const Vector e = ridges.eigenvectors().col(i);
      x += e * (e.dot(b) / std::max(std::abs(ridges.eigenvalues()[i]), kFloor));
    }
    return x;
  }
}

using Basis = std::array<Vec3, 3>;

/// Returns the step [m]: `held`, plus a part in N free directions, `places`. At the end of the step
/// the pulls vanish along `forces`. A step d reduces the pulls from `pulls` to pulls - A d.
template <int N>
Vec3 freeStep(const Basis& forces, const Basis& places, const Mat3& A, const Vec3& pulls,
              const Vec3& held) noexcept {
  Eigen::Matrix<double, 3, N> Y;
  Eigen::Matrix<double, 3, N> Z;
  for (int i = 0; i < N; ++i) {
    Y.col(i) = forces[static_cast<std::size_t>(i)];
    Z.col(i) = places[static_cast<std::size_t>(i)];
  }
  const Eigen::Matrix<double, N, N> S = Y.transpose() * A * Z;
  const Eigen::Matrix<double, N, 1> b = Y.transpose() * (pulls - A * held);
  return held + Z * solveFree<N>(S, b);
}

/// Returns the step [m] if the forces have the one direction n, and the places the direction c:
/// both unit vectors. The free directions of the step are those of the forces, rotated from n to c.
Vec3 stepAlong(const Vec3& n, const Vec3& c, const Mat3& A, const Vec3& pulls,
               const Vec3& held) noexcept {
  Basis free;
  Basis places;
  free[0] = n.unitOrthogonal();
  free[1] = n.cross(free[0]);
  const double over = 1.0 + n.dot(c);
  constexpr double kOpposed = 0.1;
  for (std::size_t i = 0; i < 2; ++i) {
    places[i] = over > kOpposed ? Vec3(free[i] - (n + c) * (c.dot(free[i]) / over)) : free[i];
  }
  return freeStep<2>(free, places, A, pulls, held);
}

/// Returns true if one plane that turns is the only primitive, and holds the proxy.
bool isLonePlane(std::span<const Primitive> primitives, std::span<const Vec3> forces,
                 std::span<const Varying> varying) noexcept {
  return primitives.size() == 1 && varying.size() == 1 &&
         primitives[0].kind == PrimitiveKind::kPlane && varying[0].surface &&
         !varying[0].across.isZero(0.0) && loadOf(primitives[0], forces[0]) == Load::kHeld;
}

/// newtonStep() for a lone plane with the load L; `shift` is L/k [m].
Vec3 stepOnPlane(const Vec3& residual, double shift, const Primitive& plane,
                 const Varying& varies) noexcept {
  const double size = varies.across.norm();
  const Vec3 n = plane.direction / plane.direction.norm();
  const Vec3 c = varies.across / size;
  const Mat3 A = Mat3::Identity() - shift * varies.turn;
  const Vec3 step = stepAlong(n, c, A, residual, -varies.height / size * c);
  return step.allFinite() ? step : residual;
}

/// Adds D to `slack`: the derivative at the balance of the pulls of sliding lines and points,
/// divided by k. Returns false if none slides.
bool addSlidingTurns(const Vec3& balance, double stiffness, std::span<const Primitive> primitives,
                     std::span<const Vec3> forces, Mat3& slack) noexcept {
  Mat3 D;
  bool slides = false;
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    const Primitive& p = primitives[i];
    const bool line = p.kind == PrimitiveKind::kLine;
    if (!line && p.kind != PrimitiveKind::kPoint) continue;
    if (loadOf(p, forces[i]) != Load::kYielding) continue;
    const Mat3 free = line ? Mat3(Mat3::Identity() - p.direction * p.direction.transpose())
                           : Mat3(Mat3::Identity());
    const Vec3 d = free * (balance - p.position);
    const double length = d.norm();
    if (!(length > 0.0)) continue;
    if (!slides) D.setZero();
    slides = true;
    D += p.strength / (stiffness * length) * (free - d * d.transpose() / (length * length));
  }
  if (slides) slack += D;
  return slides;
}

}  // namespace

Vec3 newtonStep(const Vec3& balance, const Vec3& from, const Vec3& read, double stiffness,
                std::span<const Primitive> primitives, std::span<const Vec3> forces,
                std::span<const Varying> varying) noexcept {
  Vec3 residual = balance - from;
  if (isLonePlane(primitives, forces, varying)) {
    return stepOnPlane(residual, forces[0].norm() / stiffness, primitives[0], varying[0]);
  }
  Mat3 surfaces = Mat3::Zero();
  Mat3 others = Mat3::Zero();
  bool varies = false;
  bool follows = false;  // true if `others` is not zero
  for (const Varying& one : varying) {
    const Primitive& primitive = primitives[one.index];
    const Vec3& force = forces[one.index];
    const double load = force.norm();
    if (!(load > 0.0)) continue;
    Mat3& M = one.surface ? surfaces : others;
    M += load / stiffness * one.turn;
    const bool gives_all = primitive.kind == PrimitiveKind::kForce ||
                           (!one.slope.isZero(0.0) && loadOf(primitive, force) == Load::kYielding);
    if (gives_all) M += force / (load * stiffness) * one.slope.transpose();
    varies = true;
    follows = follows || !one.surface;
  }
  if (!varies) return residual;
  const Held held = heldBy(residual, primitives, forces, varying);
  const Vec3 along = held.places.step();
  Mat3 A = Mat3::Identity();  // I + D - M
  Vec3 pulls = residual;      // (I + D) residual, and the turn of the others since their reading
  if (addSlidingTurns(balance, stiffness, primitives, forces, A)) pulls = A * residual;
  A -= surfaces;
  if (follows) {
    A -= others;
    pulls += others * (from - read);
  }
  Basis free;
  Basis places;
  Vec3 step = along;
  if (held.forces.count == 0) {
    free = places = {Vec3::UnitX(), Vec3::UnitY(), Vec3::UnitZ()};
    step = freeStep<3>(free, places, A, pulls, along);
  } else if (held.forces.count == 1) {
    step = stepAlong(held.forces.direction[0], held.places.direction[0], A, pulls, along);
  } else if (held.forces.count == 2) {
    free[0] = held.forces.direction[0].cross(held.forces.direction[1]);
    places[0] = held.places.direction[0].cross(held.places.direction[1]);
    if (places[0].dot(free[0]) < 0.0) places[0] = -places[0];
    step = freeStep<1>(free, places, A, pulls, along);
  }
  return step.allFinite() ? step : residual;
}

}  // namespace palpate
