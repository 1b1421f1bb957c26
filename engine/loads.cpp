#include "palpate/engine/loads.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include <Eigen/Cholesky>

namespace palpate {
namespace {

/// A primitive that shares a load. Without initial values, since there is room for a thousand.
struct Shared {
  std::size_t source;  ///< Index of the primitive.
  PrimitiveKind kind;
  double strength;
  Vec3 q;
  Vec3 pull;  ///< d / (1 - |d|), d the displacement from its kink in units of
              ///< kSharedWithin, at which the primitive shares nothing any more

  /// The component of v that the primitive constrains: P v.
  [[nodiscard]] Vec3 constrained(const Vec3& v) const noexcept {
    if (kind == PrimitiveKind::kPoint) return v;
    const Vec3 along = q.dot(v) * q;
    return kind == PrimitiveKind::kPlane ? along : Vec3(v - along);
  }

  /// Of all forces that the primitive can exert the one nearest to s (P lambda - pull) [N]; the
  /// pull grows beyond all bounds as |d| approaches 1. Adds the force's derivative by lambda to H.
  [[nodiscard]] Vec3 forceAt(const Vec3& lambda, Mat3& H) const noexcept {
    if (kind == PrimitiveKind::kPlane) {
      const double along = q.dot(lambda - pull);
      if (along > 0.0 && along < 1.0) H += (strength * q) * q.transpose();
      return strength * std::clamp(along, 0.0, 1.0) * q;
    }
    const Vec3 u = constrained(lambda) - pull;
    Mat3 P = Mat3::Identity();
    if (kind == PrimitiveKind::kLine) P -= q * q.transpose();
    const double length = u.norm();
    if (length <= 1.0) {
      H += strength * P;
      return strength * u;
    }
    H += strength / length * (P - u * u.transpose() / (length * length));
    return strength / length * u;
  }
};

}  // namespace

void shareLoads(const Vec3& probe, std::span<const Primitive> primitives, const SolveResult& result,
                std::span<Vec3> forces) noexcept {
  constexpr int kMostSteps = 60;
  constexpr double kEnough = 1e-10;  // share of the sum of strengths
  constexpr double kGood = 1e-6;
  if (result.solver == SolverKind::kClosedForm || result.status == SolveStatus::kBadInput) return;
  std::array<Shared, kMaxPrimitives> all;
  std::size_t sharing = 0;
  double strength = 0.0;
  Vec3 load = Vec3::Zero();
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    const Primitive& p = primitives[i];
    if (p.kind == PrimitiveKind::kForce || !(p.strength > 0.0)) continue;
    Shared& shared = all[sharing];
    shared.source = i;
    shared.kind = p.kind;
    shared.strength = p.strength;
    shared.q = p.direction;
    const Vec3 d = shared.constrained((probe - p.position) + result.offset) / kSharedWithin;
    if (d.squaredNorm() >= 1.0) continue;
    shared.pull = d / (1.0 - d.norm());
    strength += p.strength;
    load += forces[i];
    ++sharing;
  }
  if (sharing < 2) return;
  const std::span<const Shared> shared = std::span<const Shared>(all).first(sharing);

  // sum f_i(lambda) = load: the sum is the gradient of a convex function of lambda. Newton, and
  // along each step a search for the minimum of that function less load.lambda: there the missing
  // force's component along the step is zero.
  Mat3 H;
  const auto missing_at = [&](const Vec3& lambda) {
    H = 1e-9 * strength * Mat3::Identity();
    Vec3 missing = load;
    for (const Shared& one : shared) missing -= one.forceAt(lambda, H);
    return missing;
  };
  Vec3 lambda = load / strength;
  Vec3 missing = missing_at(lambda);
  for (int k = 0; k < kMostSteps && missing.norm() > kEnough * strength; ++k) {
    const Vec3 step = H.ldlt().solve(missing);
    const Vec3 from = lambda;
    const double slope = missing.dot(step);
    double low = 0.0;
    double high = std::numeric_limits<double>::infinity();
    double way = 1.0;
    for (; k < kMostSteps; ++k) {
      lambda = from + way * step;
      missing = missing_at(lambda);
      const double here = missing.dot(step);
      if (std::abs(here) <= 0.3 * slope) break;
      (here > 0.0 ? low : high) = way;
      way = high < std::numeric_limits<double>::infinity() ? 0.5 * (low + high) : 4.0 * way;
    }
  }
  if (!(missing.norm() <= kGood * strength)) return;
  for (const Shared& one : shared) forces[one.source] = one.forceAt(lambda, H);
}

}  // namespace palpate
