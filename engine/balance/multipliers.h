/// Private to engine/balance: Newton on Moreau envelopes, and the proximal method of multipliers.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "palpate/engine/balance/certificate.h"
#include "palpate/engine/balance/solver.h"
#include "palpate/engine/balance/terms.h"

namespace palpate::solver {

/// A line search ends when |slope| is at most this share of its value at the start.
inline constexpr double kSlopeLeft = 0.03;
/// If |z|^2 is below this, the multiplier is inside its ball: the primitive is on its kink.
inline constexpr double kOnKink = 1.0 - 1e-12;

/// Returns u = z + d/gamma of term i, projected on the range of P, because 1/gamma amplifies
/// rounding outside this range.
inline Triple multiplierAt(const Terms& t, std::size_t i, double per_gamma, double x, double y,
                           double z) noexcept {
  const auto [dx, dy, dz] = displacement(t, i, x, y, z);
  return constrained(t, i, t.z[0][i] + per_gamma * dx, t.z[1][i] + per_gamma * dy,
                     t.z[2][i] + per_gamma * dz);
}

/// Two ways to decide whether a primitive is on its kink.
enum class Pieces : std::uint8_t {
  kActual,    ///< Decides by u: the primitive is on its kink if |u| <= 1.
  kBelieved,  ///< Decides by the multiplier: the primitive is on its kink if |z| < 1.
};

/// Returns the gradient at `at` of the potential in which the Moreau envelope around z replaces
/// each norm, and writes the (generalised) Hessian and Terms::u. With u = z + (P at - b)/gamma, the
/// gradient of a term is sigma u on its kink and sigma u/|u| off its kink.
template <Pieces pieces>
inline Vec3 envelopeGradient(Problem& problem, double gamma, const Vec3& at, Mat3& H) noexcept {
  Terms& t = problem.terms;
  const double x = at.x();
  const double y = at.y();
  const double z = at.z();
  const double per_gamma = 1.0 / gamma;
  double gx = 0.0;
  double gy = 0.0;
  double gz = 0.0;
  double hxx = 0.0;
  double hyy = 0.0;
  double hzz = 0.0;
  double hxy = 0.0;
  double hxz = 0.0;
  double hyz = 0.0;
#pragma omp simd reduction(+ : gx, gy, gz, hxx, hyy, hzz, hxy, hxz, hyz)
  for (std::size_t i = 0; i < t.count; ++i) {
    const double alpha = t.alpha[i];
    const double beta = t.beta[i];
    const double qx = t.q[0][i];
    const double qy = t.q[1][i];
    const double qz = t.q[2][i];
    const auto [ux, uy, uz] = multiplierAt(t, i, per_gamma, x, y, z);
    t.u[0][i] = ux;
    t.u[1][i] = uy;
    t.u[2][i] = uz;
    const double r = std::sqrt(ux * ux + uy * uy + uz * uz);
    bool on = r <= 1.0;
    double shrink = 1.0 / larger(r, 1.0);
    if constexpr (pieces == Pieces::kBelieved) {
      on = t.z[0][i] * t.z[0][i] + t.z[1][i] * t.z[1][i] + t.z[2][i] * t.z[2][i] < kOnKink;
      shrink = on ? 1.0 : 1.0 / larger(r, kEpsilon);
    }
    const double ex = shrink * ux;
    const double ey = shrink * uy;
    const double ez = shrink * uz;
    const double sigma = t.sigma[i];
    gx += sigma * ex;
    gy += sigma * ey;
    gz += sigma * ez;
    // The Hessian of a term is c P on its kink and c (P - e e^T) off it; P = e e^T for a plane.
    const double c = per_gamma * sigma * shrink * (on ? 1.0 : alpha);
    const double curl = on ? 0.0 : c;
    const double cb = c * beta;
    const double ca = c * alpha;
    hxx += ca + cb * qx * qx - curl * ex * ex;
    hyy += ca + cb * qy * qy - curl * ey * ey;
    hzz += ca + cb * qz * qz - curl * ez * ez;
    hxy += cb * qx * qy - curl * ex * ey;
    hxz += cb * qx * qz - curl * ex * ez;
    hyz += cb * qy * qz - curl * ey * ez;
  }
  H << 1.0 + hxx, hxy, hxz, hxy, 1.0 + hyy, hyz, hxz, hyz, 1.0 + hzz;
  return at - problem.spring + Vec3(gx, gy, gz);
}

/// The envelope along a straight line from the place of the last call of envelopeGradient. With v =
/// P step / gamma and c = |v|^2, the length of u + t v is sqrt(c (t - turn)^2 + nearest).
class Line {
 public:
  Line(Problem& problem, double gamma, const Vec3& at, const Vec3& step) noexcept
      : terms_(problem.terms),
        gamma_(gamma),
        slope_((at - problem.spring).dot(step)),
        curvature_(step.squaredNorm()) {
    Terms& t = terms_;
    const double per_gamma = 1.0 / gamma;
    const double x = step.x();
    const double y = step.y();
    const double z = step.z();
#pragma omp simd
    for (std::size_t i = 0; i < t.count; ++i) {
      const auto [px, py, pz] = constrained(t, i, x, y, z);
      const double vx = per_gamma * px;
      const double vy = per_gamma * py;
      const double vz = per_gamma * pz;
      const double c = vx * vx + vy * vy + vz * vz;
      const double ux = t.u[0][i];
      const double uy = t.u[1][i];
      const double uz = t.u[2][i];
      const double turn =
          -(ux * vx + uy * vy + uz * vz) / larger(c, std::numeric_limits<double>::min());
      const double nx = ux + turn * vx;
      const double ny = uy + turn * vy;
      const double nz = uz + turn * vz;
      t.u[0][i] = turn;
      t.u[1][i] = c;
      t.u[2][i] = nx * nx + ny * ny + nz * nz;
    }
  }

  /// Returns the derivative of the envelope by t, which rises with t.
  [[nodiscard]] double slope(double at) const noexcept {
    const Terms& t = terms_;
    double sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (std::size_t i = 0; i < t.count; ++i) {
      const double past = at - t.u[0][i];
      const double c = t.u[1][i];
      const double r = std::sqrt(c * past * past + t.u[2][i]);
      sum += t.sigma[i] * c * past / larger(r, 1.0);
    }
    return slope_ + at * curvature_ + gamma_ * sum;
  }

  /// Searches for a t between 0 and 1 at which |slope| is at most kSlopeLeft times its value at 0,
  /// with at most 40 trials. The slope is `at_start` < 0 at 0 and `at_end` > 0 at 1. The search is
  /// bracketed, by Chandrupatla's mix of inverse quadratic interpolation and halving. Kinks may be
  /// many orders of magnitude nearer to 0 than to 1. So if the ends of the bracket differ more than
  /// tenfold, the halving applies to the exponent of t.
  [[nodiscard]] double lowest(double at_start, double at_end) const noexcept {
    constexpr int kMostTrials = 40;
    constexpr double kNearest = 1e-15;
    const double enough = -kSlopeLeft * at_start;
    // a is the newest point, b the other end of the bracket, c the previous point.
    double a = 1.0;
    double at_a = at_end;
    double b = 0.0;
    double at_b = at_start;
    double t = at_start / (at_start - at_end);
    for (int i = 0; i < kMostTrials; ++i) {
      const double at_t = slope(t);
      if (std::abs(at_t) <= enough) break;
      const bool same_side = (at_t > 0.0) == (at_a > 0.0);
      const double c = same_side ? a : b;
      const double at_c = same_side ? at_a : at_b;
      if (!same_side) {
        b = a;
        at_b = at_a;
      }
      a = t;
      at_a = at_t;
      const double shortest = kEpsilon / std::abs(b - a);
      if (shortest > 0.5) break;
      const double xi = (a - b) / (c - b);
      const double phi = (at_a - at_b) / (at_c - at_b);
      double share = 0.0;  // share of the interval from a to b
      if (phi * phi < xi && (1.0 - phi) * (1.0 - phi) < 1.0 - xi) {
        share = at_a / (at_b - at_a) * at_c / (at_b - at_c) +
                (c - a) / (b - a) * at_a / (at_c - at_a) * at_b / (at_c - at_b);
      } else {
        const double low = std::max(std::min(a, b), kNearest);
        const double high = std::max(a, b);
        share = ((high > 10.0 * low ? std::sqrt(low * high) : 0.5 * (a + b)) - a) / (b - a);
      }
      t = a + std::clamp(share, shortest, 1.0 - shortest) * (b - a);
    }
    return t;
  }

 private:
  Terms& terms_;
  double gamma_;
  double slope_;
  double curvature_;
};

/// Sets the multipliers to u, or to its nearest point of the unit ball. With kBelieved, shortens a
/// multiplier instead if u points against it.
template <Pieces pieces>
inline void updateMultipliers(Problem& problem, double gamma, const Vec3& at) noexcept {
  Terms& t = problem.terms;
  const double x = at.x();
  const double y = at.y();
  const double z = at.z();
  const double per_gamma = 1.0 / gamma;
#pragma omp simd
  for (std::size_t i = 0; i < t.count; ++i) {
    const double zx = t.z[0][i];
    const double zy = t.z[1][i];
    const double zz = t.z[2][i];
    const auto [ux, uy, uz] = multiplierAt(t, i, per_gamma, x, y, z);
    const double r = std::sqrt(ux * ux + uy * uy + uz * uz);
    const double shrink = 1.0 / larger(r, 1.0);
    double nx = shrink * ux;
    double ny = shrink * uy;
    double nz = shrink * uz;
    if constexpr (pieces == Pieces::kBelieved) {
      // A term that was assumed to be off its kink, but ends on the opposite side, is on its kink.
      const bool crossed = ux * zx + uy * zy + uz * zz < 0.0;
      nx = crossed ? 0.9 * zx : nx;
      ny = crossed ? 0.9 * zy : ny;
      nz = crossed ? 0.9 * zz : nz;
    }
    t.z[0][i] = nx;
    t.z[1][i] = ny;
    t.z[2][i] = nz;
  }
}

/// Runs semismooth Newton on the envelope from y, until the expected decrease of a step is at most
/// `enough`. Counts linear solves in `solves`. Returns false after `most` linear solves.
inline bool minimiseEnvelope(Problem& problem, double gamma, double enough, int most, Vec3& y,
                             int& solves) noexcept {
  for (int i = 0; i < most; ++i) {
    Mat3 H;
    const Vec3 g = envelopeGradient<Pieces::kActual>(problem, gamma, y, H);
    const Vec3 step = -solve3(H, g);
    ++solves;
    const double slope = g.dot(step);  // < 0: a full step lowers the envelope by about -slope/2
    const Line line(problem, gamma, y, step);
    const double end = line.slope(1.0);
    y += (end > -kSlopeLeft * slope ? line.lowest(slope, end) : 1.0) * step;
    if (-0.5 * slope <= enough) return true;
  }
  return false;
}

/// Searches for the balance in the general case, until certify() accepts a guess.
class Search {
 public:
  Search(Problem& problem, const SolverParams& params) noexcept
      : problem_(problem), params_(params) {}

  /// Assumes that the primitives that held the proxy in the last tick still hold it: their kinks
  /// become springs with a compliance of kGamma. All other primitives keep their norms. Newton's
  /// method minimises the resulting potential. Returns true if a bound proves that the result is
  /// within the tolerance.
  bool warm(Vec3 y) noexcept {
    constexpr double kGamma = 1e-10;
    constexpr int kMostSolves = 4;
    for (int i = 0; i < std::min(kMostSolves, left()); ++i) {
      Mat3 H;
      const Vec3 g = envelopeGradient<Pieces::kBelieved>(problem_, kGamma, y, H);
      y -= solve3(H, g);
      ++solves_;
      updateMultipliers<Pieces::kBelieved>(problem_, kGamma, y);
      if (prove(y)) return true;
    }
    return false;
  }

  /// Runs the proximal method of multipliers: in each round, Newton minimises envelopes around z,
  /// and then gamma is reduced. The result is exact at kinks, and the conditioning does not worsen
  /// with a smaller tolerance. The method starts without memory, because a start at the edge of the
  /// unit balls can stop Newton. Returns true if a bound proves that the result is within the
  /// tolerance.
  bool cold() noexcept {
    constexpr double kFirstGamma = 0.3;
    constexpr double kTighten = 0.03;
    constexpr double kLastGamma = 1e-13;
    // if gamma is below this, the origin moves to the iterate in each round
    constexpr double kNear = 1e-3;
    // A rough minimum of each envelope is enough, because the multipliers compensate for the error.
    constexpr double kLoose = 1e5;
    // If a round takes more steps than this, gamma was reduced too fast. The loop then increases
    // gamma, and reduces it more slowly from then on. Otherwise the rounds could repeat forever.
    constexpr int kMostOfRound = 8;
    constexpr double kRelax = 12.0;
    constexpr double kCareful = 0.35;

    for (auto& axis : problem_.terms.z) std::fill_n(axis, problem_.terms.count, 0.0);
    Vec3 y = problem_.spring;
    double gamma = kFirstGamma;
    double tighten = kTighten;
    while (left() > 0) {
      if (gamma < kNear) {
        moveOrigin(y);
        y.setZero();
      }
      const double enough = std::max(kLoose * gamma * gamma, 1e-30);
      if (minimiseEnvelope(problem_, gamma, enough, std::min(kMostOfRound, left()), y, solves_)) {
        updateMultipliers<Pieces::kActual>(problem_, gamma, y);
        if (prove(y)) return true;
        gamma = std::max(tighten * gamma, kLastGamma);
      } else {
        gamma *= kRelax;
        tighten = kCareful;
      }
    }
    return false;
  }

  /// Keeps the guess if its bound is the least so far. Returns true if the least bound is within
  /// the tolerance.
  bool prove(const Vec3& guess) noexcept {
    bool by_multipliers = true;
    const double bound = certify(problem_, guess, by_multipliers);
    if (bound < best_bound_) {
      best_bound_ = bound;
      best_ = guess;
    }
    if (best_bound_ > params_.tolerance) return false;
    if (!by_multipliers) turnAlongDisplacements(problem_, guess);
    return true;
  }

  [[nodiscard]] Vec3 offset() const noexcept { return problem_.offset(best_); }
  [[nodiscard]] double bound() const noexcept { return problem_.length * best_bound_; }
  [[nodiscard]] int solves() const noexcept { return solves_; }

  void moveOrigin(const Vec3& to) noexcept {
    problem_.moveOrigin(to);
    best_ -= to;
  }

 private:
  [[nodiscard]] int left() const noexcept { return params_.max_iterations - solves_; }

  Problem& problem_;
  const SolverParams& params_;
  int solves_ = 0;
  Vec3 best_ = problem_.spring;
  double best_bound_ = 1.0;  // all terms together pull with at most T, so |y* - spring| <= 1
};

}  // namespace palpate::solver
