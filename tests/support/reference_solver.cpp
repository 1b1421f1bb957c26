#include "tests/support/reference_solver.h"

#include <cmath>
#include <vector>

namespace palpate::test {
namespace {

__extension__ using Real = __float128;  // 113 bits

Real sqrtOf(Real x) {
  if (!(x > 0)) return 0;
  // Scales x into a double's range. Each Heron step then doubles the number of correct digits.
  Real scale = 1;
  while (x * scale * scale < Real(1e-200)) scale *= Real(1e100);
  x *= scale * scale;
  Real root = std::sqrt(static_cast<double>(x));
  for (int i = 0; i < 2; ++i) root = (root + x / root) / 2;
  return root / scale;
}

Real absOf(Real x) {
  return x < 0 ? -x : x;
}

struct Vec {
  Real x = 0;
  Real y = 0;
  Real z = 0;
};
Vec operator+(const Vec& a, const Vec& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
Vec operator-(const Vec& a, const Vec& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
Vec operator*(Real s, const Vec& a) {
  return {s * a.x, s * a.y, s * a.z};
}
Real dot(const Vec& a, const Vec& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
Vec from(const Vec3& v) {
  return {v.x(), v.y(), v.z()};
}

/// A symmetric 3 x 3 matrix.
struct Sym {
  Real xx = 0;
  Real yy = 0;
  Real zz = 0;
  Real xy = 0;
  Real xz = 0;
  Real yz = 0;
};

/// Adds c (a b^T + b a^T) / 2 to H.
void addOuter(Sym& H, Real c, const Vec& a, const Vec& b) {
  H.xx += c * a.x * b.x;
  H.yy += c * a.y * b.y;
  H.zz += c * a.z * b.z;
  H.xy += c * (a.x * b.y + a.y * b.x) / 2;
  H.xz += c * (a.x * b.z + a.z * b.x) / 2;
  H.yz += c * (a.y * b.z + a.z * b.y) / 2;
}

/// Solves H x = b by an L D L^T factorisation.
Vec solve(const Sym& H, const Vec& b) {
  const Real l10 = H.xy / H.xx;
  const Real l20 = H.xz / H.xx;
  const Real d1 = H.yy - l10 * H.xy;
  const Real l21 = (H.yz - l20 * H.xy) / d1;
  const Real d2 = H.zz - l20 * H.xz - l21 * l21 * d1;
  const Real y1 = b.y - l10 * b.x;
  const Real y2 = b.z - l20 * b.x - l21 * y1;
  Vec x;
  x.z = y2 / d2;
  x.y = y1 / d1 - l21 * x.z;
  x.x = b.x / H.xx - l10 * x.y - l20 * x.z;
  return x;
}

/// A primitive as in section 4.1 of Lundin et al., with positions relative to the probe.
struct Term {
  PrimitiveKind kind;
  Vec at;
  Vec q;
  Real s;
  Vec z;  ///< -f / s, in the unit ball; for a plane without the constant half of its force
};

/// Returns the displacement from the primitive, whose length gives the potential. For a plane it is
/// along q.
Vec away(const Term& t, const Vec& x) {
  const Vec d = x - t.at;
  if (t.kind == PrimitiveKind::kPoint) return d;
  if (t.kind == PrimitiveKind::kLine) {
    // Projects twice, because near the line the rounding error along q is not small relative to the
    // rest.
    const Vec once = d - dot(t.q, d) * t.q;
    return once - dot(t.q, once) * t.q;
  }
  return dot(t.q, d) * t.q;  // kPlane
}

class Potential {
 public:
  Potential(const Vec3& probe, double stiffness, std::span<const Primitive> primitives)
      : k_(stiffness) {
    for (const Primitive& p : primitives) {
      Vec q = from(p.direction);
      if (p.kind != PrimitiveKind::kPoint) q = (1 / sqrtOf(dot(q, q))) * q;
      strengths_ += p.strength;
      if (p.kind == PrimitiveKind::kForce) {
        push_ = push_ + Real(p.strength) * q;
      } else if (p.strength > 0) {
        terms_.push_back({p.kind, from(p.position) - from(probe), q, p.strength, {}});
      }
    }
  }

  [[nodiscard]] Real reach() const { return strengths_ / k_; }

  /// Returns E(x).
  [[nodiscard]] Real value(const Vec& x) const {
    Real e = k_ * dot(x, x) / 2 - dot(push_, x);
    for (const Term& t : terms_) {
      const Vec d = away(t, x);
      const Real length = sqrtOf(dot(d, d));
      // for a plane: max(0, t) = (t + |t|) / 2
      e += t.kind == PrimitiveKind::kPlane ? t.s * (length - dot(t.q, d)) / 2 : t.s * length;
    }
    return e;
  }

  /// Returns the primitives' force on the proxy for the present z: eq. (14) without the spring.
  [[nodiscard]] Vec force() const {
    Vec f = push_;
    for (const Term& t : terms_) {
      f = f + (t.kind == PrimitiveKind::kPlane ? (t.s / 2) * (t.q - t.z) : -t.s * t.z);
    }
    return f;
  }

  /// Returns the dual D(f): the minimum over x of k/2 |x|^2 - f.x, plus the support terms of all
  /// primitives.
  [[nodiscard]] Real dual() const {
    const Vec f = force();
    Real d = -dot(f, f) / (2 * k_);
    for (const Term& t : terms_) {
      // s |P (x - a)| >= s z.(x - a) for every x, if |z| <= 1 and z is in the range of P.
      d += t.kind == PrimitiveKind::kPlane ? t.s / 2 * dot(t.q - t.z, t.at) : -t.s * dot(t.z, t.at);
    }
    return d;
  }

  [[nodiscard]] Vec gradient(const Vec& x, Real mu) const {
    Vec g = k_ * x - push_;
    for (const Term& t : terms_) {
      const bool plane = t.kind == PrimitiveKind::kPlane;
      const Real s = plane ? t.s / 2 : t.s;
      const Vec d = away(t, x);
      g = g + (s / sqrtOf(dot(d, d) + mu * mu)) * d;
      if (plane) g = g - s * t.q;
    }
    return g;
  }

  /// Makes one Newton step on the smoothed potential. Returns false if the potential cannot be
  /// lowered further.
  bool improve(Vec& x, Real mu) {
    Sym H{k_, k_, k_, 0, 0, 0};
    const Vec g = gradient(x, mu);
    for (const Term& t : terms_) {
      const bool plane = t.kind == PrimitiveKind::kPlane;
      const Real s = plane ? t.s / 2 : t.s;
      const Vec d = away(t, x);
      const Real length = sqrtOf(dot(d, d) + mu * mu);
      // The term is s/length (P - z d^T/length). With z = d/length it is the Hessian. With the last
      // z, projected into its ball, the result is a better start for the next mu (Andersen et al.
      // 2000).
      const Real c = s / length;
      if (!plane) {
        H.xx += c;
        H.yy += c;
        H.zz += c;
      }
      if (t.kind == PrimitiveKind::kLine) addOuter(H, -c, t.q, t.q);
      if (plane) addOuter(H, c, t.q, t.q);
      addOuter(H, -c / length, t.z, d);
    }
    const Vec step = solve(H, -1 * g);
    const Real slope = dot(g, step);
    if (!(slope < 0)) return false;
    // Halves the step while the potential rises at its end. Tests the slope, which rises along the
    // step because E is convex: differences of E would be lost in rounding.
    Real t = 1;
    while (t > Real(1e-30) && dot(gradient(x + t * step, mu), step) > -slope / 2) t /= 2;
    for (Term& term : terms_) {
      const Vec d = away(term, x);
      const Vec move = t * (away(term, x + step) - d);
      const Real length = sqrtOf(dot(d, d) + mu * mu);
      term.z = (1 / length) * (d + move) - (dot(d, move) / (length * length)) * term.z;
      pull(term);
    }
    x = x + t * step;
    return -slope > k_ * mu * mu / 100;
  }

  /// Sets z to the gradients of the smoothed norms at x.
  void place(const Vec& x, Real mu) {
    for (Term& t : terms_) {
      const Vec d = away(t, x);
      t.z = (1 / sqrtOf(dot(d, d) + mu * mu)) * d;
      pull(t);
    }
  }

 private:
  /// Shortens z to the unit ball.
  static void pull(Term& t) {
    const Real length = sqrtOf(dot(t.z, t.z));
    if (length > 1) t.z = (1 / length) * t.z;
  }

  Real k_;
  Real strengths_ = 0;
  Vec push_;
  std::vector<Term> terms_;
};

}  // namespace

Reference solveReference(const Vec3& probe, double stiffness,
                         std::span<const Primitive> primitives) {
  constexpr int kDecades = 20;
  constexpr int kMostSteps = 100;
  Potential potential(probe, stiffness, primitives);
  Vec x = (1 / Real(stiffness)) * potential.force();
  Real mu = potential.reach();
  if (mu > 0) {
    potential.place(x, mu);
    for (int decade = 0; decade < kDecades; ++decade) {
      mu /= 10;
      for (int i = 0; i < kMostSteps && potential.improve(x, mu); ++i) {
      }
    }
    potential.place(x, mu);
  }
  const auto number = [](Real r) { return static_cast<double>(r); };
  Reference out;
  out.offset = {number(x.x), number(x.y), number(x.z)};
  // The offset is rounded to double; E and D have 113 bits relative to their own magnitudes.
  const Real value = potential.value(x);
  const Real dual = potential.dual();
  const Real gap = absOf(value - dual) + Real(1e-31) * (absOf(value) + absOf(dual));
  out.error_bound = number(sqrtOf(2 * gap / Real(stiffness))) + 2e-16 * out.offset.norm();
  out.potential = number(value);
  return out;
}

}  // namespace palpate::test
