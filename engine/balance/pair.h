/// Private to engine/balance: the balance of a plane and one other primitive, by a scalar equation.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "palpate/engine/balance/solver.h"
#include "palpate/engine/balance/terms.h"

namespace palpate::solver {

/// Balances a plane and one other primitive, such as a surface with a drag. The plane's term shifts
/// the spring's end by -a q, with a = sigma_plane zeta. A soft threshold then balances the other
/// primitive. zeta is -1 behind the plane, 1 in front of it, and between -1 and 1 on it. This
/// condition is monotone in a.
///
/// Let P be the projector of the other primitive, and e = P q. Let d be the displacement from that
/// primitive's kink before its own force acts, and s = q.d. Then a = (s_0 - s)/|e|^2 and |d|^2 =
/// s^2/|e|^2 + aside^2, and the height over the plane is
///
///     h(s) = h_0 - (1/|e|^2 - 1) (s_0 - s) + max(0, 1 - sigma/|d|) s,
///
/// with s_0 and h_0 at a = 0. h(s) is linear where the other primitive holds (|d| <= sigma). Beyond
/// that range it is convex on one side and concave on the other.
class Pair {
 public:
  Pair(const Problem& problem, std::size_t plane, std::size_t other) noexcept
      : q_(get(problem.terms.q, plane)),
        foot_(q_.dot(get(problem.terms.b, plane))),
        most_(problem.terms.sigma[plane]),
        sigma_(problem.terms.sigma[other]),
        e_(project(problem.terms, other, q_)),
        d_(project(problem.terms, other, problem.spring) - get(problem.terms.b, other)),
        // The kink of a point is the point itself, without rounding.
        kink_(problem.terms.beta[other] == 0.0 ? get(problem.terms.b, other)
                                               : Vec3(problem.spring - d_)),
        e2_(e_.squaredNorm()),
        slope_(1.0 / e2_ - 1.0),
        s0_(e_.dot(d_)),
        h0_(q_.dot(kink_) - foot_),
        aside2_((d_ - (s0_ / e2_) * e_).squaredNorm()) {}

  /// Finds the plane's force at which |height| <= `enough`; if the proxy is off the plane, the
  /// force is at its limit. Returns the number of heights evaluated.
  int solve(double enough) noexcept {
    double low = s0_ - most_ * e2_;
    double high = s0_ + most_ * e2_;
    int evaluations = 1;
    double s = low;
    if (height(low) < 0.0) {
      ++evaluations;
      s = high;
      if (height(high) > 0.0) {
        // The other primitive holds if s is between -edge and edge.
        const double room = sigma_ * sigma_ - aside2_;
        const double edge = room > 0.0 ? std::sqrt(room * e2_) : 0.0;
        const double left = std::clamp(-edge, low, high);
        const double right = std::clamp(edge, low, high);
        if (held(right) < 0.0) {
          evaluations += slide(right, high, right, enough, s);
        } else if (held(left) > 0.0) {
          evaluations += slide(low, left, left, enough, s);
        } else {
          // If slope_ is 0, the point lies on the plane and holds for every s in the range.
          s = slope_ > kEpsilon ? std::clamp(s0_ - h0_ / slope_, left, right) : left;
        }
      }
    }
    force_ = std::clamp((s0_ - s) / e2_, -most_, most_);
    return evaluations;
  }

  /// Returns the proxy. Off the other primitive's kink, the displacement from the kink has the
  /// direction of d to the last digit.
  [[nodiscard]] Vec3 proxy() const noexcept {
    const Vec3 d = d_ - force_ * e_;
    const Vec3 kink = kink_ - force_ * (q_ - e_);
    const double r = d.norm();
    return r > sigma_ ? Vec3(kink + ((r - sigma_) / r) * d) : kink;
  }

  [[nodiscard]] Vec3 planeMultiplier() const noexcept { return (force_ / most_) * q_; }
  [[nodiscard]] Vec3 otherMultiplier() const noexcept {
    const Vec3 d = d_ - force_ * e_;
    return d / std::max(d.norm(), sigma_);
  }

  /// Returns an upper bound on |y - y*|. In the duality gap, the term of the other primitive and
  /// the imbalance vanish. The bound includes the possible rounding error of h. For a point, the
  /// kink has no rounding error, and q = e.
  [[nodiscard]] double bound(const Vec3& y) const noexcept {
    const double h = q_.dot(y) - foot_;
    const double lever = e_ == q_ ? 0.0 : std::abs(force_) + d_.norm();
    const double hidden = 4.0 * kEpsilon * (kink_.norm() + y.norm() + std::abs(foot_) + lever);
    return std::sqrt(2.0 * (most_ * (std::abs(h) + hidden) - force_ * h));
  }

 private:
  /// Returns h(s) where the other primitive holds.
  [[nodiscard]] double held(double s) const noexcept { return h0_ - slope_ * (s0_ - s); }
  [[nodiscard]] double distance(double s) const noexcept {
    return std::sqrt(s * s / e2_ + aside2_);
  }
  [[nodiscard]] double height(double s) const noexcept {
    return held(s) + (1.0 - sigma_ / std::max(distance(s), sigma_)) * s;
  }

  /// Runs Newton from `start` within [low, high], where h(low) <= 0 <= h(high). There h is convex
  /// or concave, so Newton overshoots at most once. Returns the number of heights evaluated, at
  /// most kMost. If Newton's method did not converge, s is the last place; bound() then decides.
  int slide(double low, double high, double start, double enough, double& s) const noexcept {
    constexpr int kMost = 21;
    const double last_digit = kEpsilon * (std::abs(s0_) + most_ * e2_);
    s = start;
    for (int i = 1; i <= kMost; ++i) {
      const double h = height(s);
      if (std::abs(h) <= enough) return i;
      (h > 0.0 ? high : low) = s;
      const double r = std::max(distance(s), sigma_);
      const double slope = slope_ + 1.0 - sigma_ * aside2_ / (r * r * r);
      double next = s - h / slope;
      if (!(next > low && next < high)) next = 0.5 * (low + high);
      if (std::abs(next - s) <= last_digit) return i;
      s = next;
    }
    return kMost;
  }

  Vec3 q_;
  double foot_;   ///< q.b of the plane
  double most_;   ///< sigma of the plane
  double sigma_;  ///< sigma of the other primitive
  Vec3 e_;
  Vec3 d_;  ///< d at zero force of the plane
  /// point of the other primitive's kink that is nearest to the spring's end, at zero plane force
  Vec3 kink_;
  double e2_;
  double slope_;
  double s0_;
  double h0_;
  double aside2_;
  double force_ = 0.0;  ///< a, minus the force of the plane's term along q
};

/// Balances two primitives by Pair. Returns false if neither primitive is a plane, or the bound
/// exceeds the tolerance.
inline bool trySolvePair(const Problem& problem, const SolverParams& params,
                         SolveResult& result) noexcept {
  const std::size_t plane = problem.terms.alpha[0] == 0.0 ? 0 : 1;
  if (problem.terms.alpha[plane] != 0.0) return false;
  Pair pair(problem, plane, 1 - plane);
  const double enough = std::max(4.0 * kEpsilon, 0.01 * params.tolerance * params.tolerance);
  const int evaluations = pair.solve(enough);
  const Vec3 y = pair.proxy();
  const double bound = pair.bound(y);
  if (!(bound <= params.tolerance)) return false;
  result.iterations = evaluations;
  result.offset = problem.offset(y);
  result.error_bound = problem.length * bound;
  set(problem.terms.z, plane, pair.planeMultiplier());
  set(problem.terms.z, 1 - plane, pair.otherMultiplier());
  return true;
}

}  // namespace palpate::solver
