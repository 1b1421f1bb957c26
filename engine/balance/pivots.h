/// Private to engine/balance: the balance of planes alone, by pivots between their cells.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <utility>

#include "palpate/engine/balance/solver.h"
#include "palpate/engine/balance/terms.h"

namespace palpate::solver {

/// Balances planes by pivots. The planes divide space into cells, and the potential is quadratic in
/// each cell. In each pivot, y moves along a straight line to the least potential: to a plane,
/// which then holds, or to a point within a cell. A pivot releases a plane with a force above its
/// strength. At most three planes hold at the same time. A few pivots are enough, unless many kinks
/// meet at the proxy.
class Pivots {
 public:
  explicit Pivots(Problem& problem) noexcept : problem_(problem), terms_(problem.terms) {}

  /// Returns true if all terms are planes; lines and points do not form cells.
  [[nodiscard]] static bool fits(const Terms& terms) noexcept {
    return std::all_of(terms.alpha, terms.alpha + terms.count, [](double a) { return a == 0.0; });
  }

  /// Moves y to the balance and sets the multipliers. Returns false after kMostPivots pivots.
  bool solve(Vec3& y) noexcept {
    place(y);
    while (pivots_ < kMostPivots) {
      ++pivots_;
      const Vec3 g = gradient(y);
      const Vec3 d = -across(g);
      const double slope = d.squaredNorm();
      if (held_ == 3 || slope <= square(8.0 * kEpsilon * (1.0 + g.norm()))) {
        if (release(g)) continue;
        setMultipliers(g);
        return true;
      }
      y += lineSearch(d, slope) * d;
    }
    setMultipliers(gradient(y));
    return false;
  }
  /// Computes the solution again after the caller has moved the origin to it, and sets the
  /// multipliers. Near the origin, the rounding errors of heights are relative to the heights.
  [[nodiscard]] Vec3 onHeld() noexcept {
    Vec3 y = Vec3::Zero();
    for (std::size_t k = 0; k < held_; ++k) {
      const Vec3 q = get(terms_.q, holder_[k]);
      y += q.dot(get(terms_.b, holder_[k]) - y) / q.dot(basis_[k]) * basis_[k];
    }
    setMultipliers(gradient(y));
    return y;
  }
  [[nodiscard]] int pivots() const noexcept { return pivots_; }

 private:
  static double square(double x) noexcept { return x * x; }
  /// Height q.y - q.b of term i, its rate along the step, and its side (0 if the plane holds).
  [[nodiscard]] double& height(std::size_t i) const noexcept { return terms_.u[0][i]; }
  [[nodiscard]] double& rate(std::size_t i) const noexcept { return terms_.u[1][i]; }
  [[nodiscard]] double& side(std::size_t i) const noexcept { return terms_.u[2][i]; }

  void place(const Vec3& y) noexcept {
    for (std::size_t i = 0; i < terms_.count; ++i) {
      const Vec3 q = get(terms_.q, i);
      height(i) = q.dot(y - get(terms_.b, i));
      side(i) = height(i) >= 0.0 ? 1.0 : -1.0;
    }
  }

  /// Returns the gradient at y of the potential without the planes that hold.
  [[nodiscard]] Vec3 gradient(const Vec3& y) const noexcept {
    const Terms& t = terms_;
    double gx = y.x() - problem_.spring.x();
    double gy = y.y() - problem_.spring.y();
    double gz = y.z() - problem_.spring.z();
#pragma omp simd reduction(+ : gx, gy, gz)
    for (std::size_t i = 0; i < t.count; ++i) {
      const double push = t.sigma[i] * t.u[2][i];
      gx += push * t.q[0][i];
      gy += push * t.q[1][i];
      gz += push * t.q[2][i];
    }
    return {gx, gy, gz};
  }

  /// Returns the part of v perpendicular to the normals that hold. Projects twice for accuracy.
  [[nodiscard]] Vec3 across(Vec3 v) const noexcept {
    for (int twice = 0; twice < 2; ++twice) {
      for (std::size_t k = 0; k < held_; ++k) v -= basis_[k].dot(v) * basis_[k];
    }
    return v;
  }

  void hold(std::size_t i) noexcept {
    side(i) = 0.0;
    height(i) = 0.0;
    holder_[held_] = i;
    basis_[held_] = across(get(terms_.q, i)).normalized();
    ++held_;
  }

  /// Finds the minimum of the potential along the step d. Returns its distance as a share of d. The
  /// minimum is at a plane, or where the slope vanishes.
  double lineSearch(const Vec3& d, double slope) noexcept {
    const Terms& t = terms_;
    const double dx = d.x();
    const double dy = d.y();
    const double dz = d.z();
#pragma omp simd
    for (std::size_t i = 0; i < t.count; ++i) {
      t.u[1][i] = t.q[0][i] * dx + t.q[1][i] * dy + t.q[2][i] * dz;
    }
    // The plane at which the step ends is a weighted median, found by repeated partition.
    std::size_t count = 0;
    for (std::size_t i = 0; i < t.count; ++i) {
      const double toward = -side(i) * rate(i);
      const double off = side(i) * height(i);
      if (toward > 0.0 && off < toward) met_[count++] = {std::max(off, 0.0) / toward, i};
    }
    const auto less = [&](const Met& met) {
      return 2.0 * t.sigma[met.plane] * std::abs(rate(met.plane)) / slope;
    };
    // share of d at which the slope would vanish if the step passed no further planes
    double way = 1.0;
    std::size_t stop = t.count;
    Met* first = met_.data();
    Met* last = first + count;
    constexpr int kMostPartings = 64;  // largest number of partitions
    for (int parting = 0; first != last && parting < kMostPartings; ++parting) {
      const double at = first[(last - first) / 2].way;
      Met* const here = std::partition(first, last, [at](const Met& m) { return m.way < at; });
      Met* const beyond = std::partition(here, last, [at](const Met& m) { return m.way == at; });
      double before = 0.0;
      for (const Met* m = first; m != here; ++m) before += less(*m);
      if (way - before <= at) {
        last = here;  // the step ends before this plane
        continue;
      }
      for (const Met* m = first; m != here; ++m) side(m->plane) = -side(m->plane);
      way -= before;
      for (first = here; first != beyond && stop == t.count; ++first) {
        way -= less(*first);
        if (way > at) {
          side(first->plane) = -side(first->plane);
        } else {
          stop = first->plane;
          way = at;
        }
      }
      if (stop != t.count) break;
    }
    for (std::size_t i = 0; i < t.count; ++i) height(i) += way * rate(i);
    for (std::size_t k = 0; k < held_; ++k) height(holder_[k]) = 0.0;
    if (stop < t.count) hold(stop);
    return way;
  }

  /// Returns the forces of the planes that hold: sum of push_k q_k = -g.
  [[nodiscard]] std::array<double, 3> pushes(const Vec3& g) const noexcept {
    std::array<double, 3> push{};
    Vec3 left = -g;
    for (std::size_t k = held_; k-- > 0;) {
      const Vec3 q = get(terms_.q, holder_[k]);
      push[k] = left.dot(basis_[k]) / q.dot(basis_[k]);
      left -= push[k] * q;
    }
    return push;
  }

  /// Releases the plane whose force exceeds its strength most. Returns false if no force exceeds
  /// its strength by more than rounding.
  bool release(const Vec3& g) noexcept {
    const std::array<double, 3> push = pushes(g);
    double worst = 64.0 * kEpsilon;
    std::size_t drop = held_;
    for (std::size_t k = 0; k < held_; ++k) {
      const double beyond = std::abs(push[k]) - terms_.sigma[holder_[k]];
      if (beyond > worst) {
        worst = beyond;
        drop = k;
      }
    }
    if (drop == held_) return false;
    side(holder_[drop]) = push[drop] > 0.0 ? 1.0 : -1.0;
    const std::array<std::size_t, 3> before = holder_;
    const std::size_t count = std::exchange(held_, 0);
    for (std::size_t k = 0; k < count; ++k) {
      if (k != drop) hold(before[k]);
    }
    return true;
  }

  void setMultipliers(const Vec3& g) noexcept {
    const std::array<double, 3> push = pushes(g);
    for (std::size_t i = 0; i < terms_.count; ++i) set(terms_.z, i, side(i) * get(terms_.q, i));
    for (std::size_t k = 0; k < held_; ++k) {
      const double share = push[k] / terms_.sigma[holder_[k]];
      set(terms_.z, holder_[k], std::clamp(share, -1.0, 1.0) * get(terms_.q, holder_[k]));
    }
  }

  static constexpr int kMostPivots = 40;

  Problem& problem_;
  const Terms& terms_;
  /// A plane on the step, and the share of the step up to it.
  struct Met {
    double way;
    std::size_t plane;
  };
  std::array<Met, kMaxPrimitives> met_;
  std::array<std::size_t, 3> holder_{};
  std::array<Vec3, 3> basis_;  ///< The normals that hold, each made orthogonal to those before it.
  std::size_t held_ = 0;
  int pivots_ = 0;
};

}  // namespace palpate::solver
