#include "engine/loads.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>

namespace palpate {
namespace {

/// A primitive of a load that is shared: its strength, projector and displacement from its kink.
struct Shared {
  double strength = 0.0;
  bool plane = false;
  Mat3 P = Mat3::Identity();
  Vec3 q = Vec3::Zero();
  Vec3 d = Vec3::Zero();  ///< in units of the distance at which it shares nothing any more

  Shared(const Primitive& p, const Vec3& from_anchor) noexcept
      : strength(p.strength), plane(p.kind == PrimitiveKind::kPlane) {
    if (p.kind != PrimitiveKind::kPoint) q = p.direction;
    if (p.kind == PrimitiveKind::kLine) P -= q * q.transpose();
    if (plane) P = q * q.transpose();
    d = P * from_anchor / kSharedWithin;
  }
  [[nodiscard]] bool apart() const noexcept { return d.squaredNorm() >= 1.0; }

  /// On it: of all forces that it can exert the one nearest to s (P lambda - pull), where the pull
  /// grows beyond all bounds as it comes off. Adds to H how that changes with lambda.
  [[nodiscard]] Vec3 forceAt(const Vec3& lambda, Mat3& H) const noexcept {
    const Vec3 u = P * lambda - d / (1.0 - d.norm());
    if (plane) {
      const double along = q.dot(u);
      if (along > 0.0 && along < 1.0) H += strength * P;
      return strength * std::clamp(along, 0.0, 1.0) * q;
    }
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
  constexpr double kEnough = 1e-10;  // of the strengths
  constexpr double kGood = 1e-6;
  if (result.solver == SolverKind::kClosedForm || result.status == SolveStatus::kBadInput) return;
  const auto acts = [](const Primitive& p) {
    return p.kind != PrimitiveKind::kForce && p.strength > 0.0;
  };
  const auto shared_of = [&](const Primitive& p) {
    return Shared(p, (probe - p.position) + result.offset);
  };
  double strength = 0.0;
  Vec3 load = Vec3::Zero();
  int sharing = 0;
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    if (!acts(primitives[i]) || shared_of(primitives[i]).apart()) continue;
    strength += primitives[i].strength;
    load += forces[i];
    ++sharing;
  }
  if (sharing < 2) return;

  // sum f_i(lambda) = load: the gradient of a convex function of lambda. Newton, and along each
  // step a search for where that function is lowest: what is missing, along the step, falls to
  // zero.
  Mat3 H;
  const auto missing_at = [&](const Vec3& lambda) {
    H = 1e-9 * strength * Mat3::Identity();
    Vec3 missing = load;
    for (const Primitive& p : primitives) {
      if (!acts(p)) continue;
      const Shared shared = shared_of(p);
      if (!shared.apart()) missing -= shared.forceAt(lambda, H);
    }
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
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    if (!acts(primitives[i])) continue;
    const Shared shared = shared_of(primitives[i]);
    if (!shared.apart()) forces[i] = shared.forceAt(lambda, H);
  }
}

}  // namespace palpate
