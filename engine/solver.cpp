#include "engine/solver.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include <Eigen/Geometry>

namespace palpate {
namespace {

constexpr double kEpsilon = std::numeric_limits<double>::epsilon();

/// A primitive other than a directed force, as sigma |P (y - a)|: P projects on the point's three,
/// the line's two or the plane's one constrained directions. Lengths in units of S/k, forces in
/// units of S, so that sigmas add up to 1.
struct Term {
  PrimitiveKind kind;
  double sigma;
  Vec3 a;   ///< anchor
  Vec3 q;   ///< unit direction
  Vec3 z;   ///< multiplier: the primitive's force is -sigma z, |z| <= 1, in the range of P
  bool on;  ///< believed to hold the proxy on its kink (on the plane, line or point)
};

Vec3 project(const Term& term, const Vec3& d) noexcept {
  switch (term.kind) {
    case PrimitiveKind::kPoint:
      return d;
    case PrimitiveKind::kLine:
      return d - term.q * term.q.dot(d);
    case PrimitiveKind::kPlane:
      return term.q * term.q.dot(d);
    case PrimitiveKind::kForce:
      break;
  }
  return Vec3::Zero();
}

/// H += c P.
void addProjector(const Term& term, double c, Mat3& H) noexcept {
  if (term.kind != PrimitiveKind::kPlane) H.diagonal().array() += c;
  if (term.kind == PrimitiveKind::kLine) H.noalias() -= (c * term.q) * term.q.transpose();
  if (term.kind == PrimitiveKind::kPlane) H.noalias() += (c * term.q) * term.q.transpose();
}

/// Solves H x = b for a symmetric H with eigenvalues >= 1, by L D L^T.
Vec3 solve3(const Mat3& H, const Vec3& b) noexcept {
  const double l10 = H(1, 0) / H(0, 0);
  const double l20 = H(2, 0) / H(0, 0);
  const double d1 = H(1, 1) - l10 * H(1, 0);
  const double m = H(2, 1) - l10 * H(2, 0);
  const double l21 = m / d1;
  const double d2 = H(2, 2) - l20 * H(2, 0) - l21 * m;
  const double y1 = b[1] - l10 * b[0];
  const double y2 = b[2] - l20 * b[0] - l21 * y1;
  Vec3 x;
  x[2] = y2 / d2;
  x[1] = y1 / d1 - l21 * x[2];
  x[0] = b[0] / H(0, 0) - l10 * x[1] - l20 * x[2];
  return x;
}

/// Minimise |y - spring|^2 / 2 + sum sigma |P (y - a)|, dimensionless, and what restores metres.
struct Problem {
  Vec3 w;         ///< the spring's end, relative to the probe [m]: directed forces only move it
  double length;  ///< S/k [m]
  Vec3 spring;    ///< the spring's end, in units of S/k from the origin
  std::span<Term> terms;

  /// Moves the origin, so that small distances near it are not rounded to the size of others.
  void moveOrigin(const Vec3& to) noexcept {
    spring -= to;
    for (Term& term : terms) term.a -= to;
  }
  /// A solution as a displacement from the probe [m].
  [[nodiscard]] Vec3 offset(const Vec3& y) const noexcept { return w + length * (y - spring); }
};

/// Gradient at y of the potential with each norm replaced by its Moreau envelope around z, and its
/// (generalised) Hessian.
Vec3 envelopeGradient(const Problem& problem, double gamma, const Vec3& y, Mat3& H) noexcept {
  Vec3 g = y - problem.spring;
  H.setIdentity();
  for (const Term& term : problem.terms) {
    const Vec3 u = term.z + project(term, y - term.a) / gamma;
    const double r2 = u.squaredNorm();
    if (r2 <= 1.0) {
      g += term.sigma * u;
      addProjector(term, term.sigma / gamma, H);
      continue;
    }
    const double r = std::sqrt(r2);
    const Vec3 e = u / r;
    g += term.sigma * e;
    if (term.kind != PrimitiveKind::kPlane) {
      const double c = term.sigma / (gamma * r);
      addProjector(term, c, H);
      H.noalias() -= (c * e) * e.transpose();
    }
  }
  return g;
}

/// Semismooth Newton on the envelope from y, which becomes its minimiser (nearly). Returns the
/// number of linear solves, at most `budget`.
int minimiseEnvelope(const Problem& problem, double gamma, int budget, Vec3& y) noexcept {
  constexpr int kMaxTrials = 24;
  // The slope is minus the squared distance to the model's minimiser in the model's own metric:
  // well below the width of a kink, or down at the rounding of y.
  const double target = std::max(1e-3 * gamma * gamma, 1e-30);
  Mat3 H;
  Vec3 g = envelopeGradient(problem, gamma, y, H);
  int solves = 0;
  while (solves < budget) {
    const Vec3 step = -solve3(H, g);
    ++solves;
    const double slope = g.dot(step);  // < 0: the envelope falls by about -slope/2
    double t = 1.0;
    Vec3 trial = y + step;
    g = envelopeGradient(problem, gamma, trial, H);

    // Where the full step passes the valley, find the place on the way where the slope is small.
    // The slope is monotone in t, and unlike an energy difference it does not drown in rounding.
    double low = 0.0;
    double low_slope = slope;
    double high = 1.0;
    double high_slope = g.dot(step);
    for (int i = 0; i < kMaxTrials && high_slope > -0.3 * slope; ++i) {
      t = std::clamp(low + (high - low) * low_slope / (low_slope - high_slope),
                     low + 0.1 * (high - low), high - 0.1 * (high - low));
      trial = y + t * step;
      g = envelopeGradient(problem, gamma, trial, H);
      const double trial_slope = g.dot(step);
      if (std::abs(trial_slope) <= -0.3 * slope) break;
      if (trial_slope > 0.0) {
        high = t;
        high_slope = trial_slope;
      } else {
        low = t;
        low_slope = trial_slope;
      }
    }
    y = trial;
    if (-slope <= target) break;
  }
  return solves;
}

/// Upper bound on |y - y*| by the duality gap, written without cancellation: every term is >= 0.
/// The dual point: d/|d| for primitives that y is off, the multipliers for those that it is on.
double certify(const Problem& problem, const Vec3& y) noexcept {
  double gap = 0.0;
  Vec3 imbalance = y - problem.spring;
  for (const Term& term : problem.terms) {
    const Vec3 d = project(term, y - term.a);
    const double distance = d.norm();
    if (!term.on && distance > 0.0) {
      imbalance += (term.sigma / distance) * d;
    } else {
      gap += term.sigma * std::max(0.0, distance - term.z.dot(d));
      imbalance += term.sigma * term.z;
    }
  }
  return std::sqrt(2.0 * gap + imbalance.squaredNorm());
}

/// Sets the multiplier to u or its nearest point of the unit ball, and the belief with it.
void setMultiplier(const Vec3& u, Term& term) noexcept {
  const double r = u.norm();
  term.on = r <= 1.0 + 1e-12;
  term.z = r <= 1.0 ? u : Vec3(u / r);
}

/// Coordinate ascent on the dual: given the others, a primitive's best force is a projection. Exact
/// after one round where the primitives are orthogonal; else it finds who holds the proxy.
Vec3 sweep(Problem& problem, int rounds) noexcept {
  Vec3 y = problem.spring;
  for (const Term& term : problem.terms) y -= term.sigma * term.z;
  for (int round = 0; round < rounds; ++round) {
    const Vec3 before = y;
    for (Term& term : problem.terms) {
      const Vec3 others = y + term.sigma * term.z;
      setMultiplier(project(term, others - term.a) / term.sigma, term);
      y = others - term.sigma * term.z;
    }
    if ((y - before).squaredNorm() < 1e-20) break;
  }
  return y;
}

/// Takes the beliefs for true and solves for them: Newton on the norms of those that y is off, the
/// kinks of those that it is on as constraints (augmented Lagrangian). A belief that the step
/// belies is changed: a multiplier outside its ball, a kink that was crossed. Returns the linear
/// solves.
int finish(Problem& problem, int budget, Vec3& y) noexcept {
  constexpr double kGamma = 1e-7;
  constexpr int kMostSolves = 6;
  int solves = 0;
  while (solves < std::min(kMostSolves, budget)) {
    Mat3 H = Mat3::Identity();
    Vec3 g = y - problem.spring;
    for (const Term& term : problem.terms) {
      const Vec3 d = project(term, y - term.a);
      if (term.on) {
        g += term.sigma * (term.z + d / kGamma);
        addProjector(term, term.sigma / kGamma, H);
        continue;
      }
      const double distance = d.norm();
      if (!(distance > 0.0)) return solves;
      const Vec3 e = d / distance;
      g += term.sigma * e;
      if (term.kind == PrimitiveKind::kPlane) continue;
      const double c = term.sigma / distance;
      addProjector(term, c, H);
      H.noalias() -= (c * e) * e.transpose();
    }
    const Vec3 step = -solve3(H, g);
    ++solves;
    y += step;
    bool changed = false;
    for (Term& term : problem.terms) {
      const Vec3 d = project(term, y - term.a);
      if (term.on) {
        setMultiplier(term.z + d / kGamma, term);
        changed = changed || !term.on;
        continue;
      }
      const Vec3 before = project(term, y - step - term.a);
      if (d.dot(before) <= 0.0) {
        setMultiplier(before.normalized(), term);
        term.on = true;
        changed = true;
      }
    }
    if (!changed && step.squaredNorm() < 1e-22) break;
  }
  return solves;
}

/// Speculates, then proves. A few rounds of coordinate ascent tell which primitives hold the proxy;
/// Newton finishes for those; the certificate says whether that was right. If not, the proximal
/// method of multipliers starts afresh: envelopes around z, minimised by Newton, tightened. Kinks
/// come out exact, and nothing degenerates as the tolerance falls.
void solveGeneral(Problem& problem, const SolverParams& params, SolveResult& result) noexcept {
  constexpr int kRounds = 10;
  constexpr double kFirstGamma = 0.3;
  constexpr double kGammaFactor = 0.1;
  constexpr double kLastGamma = 1e-11;

  problem.moveOrigin(sweep(problem, kRounds));
  Vec3 y = Vec3::Zero();
  Vec3 best = problem.spring;
  double best_bound = 1.0;  // all primitives together pull with at most S: |y* - spring| <= 1
  const auto proved = [&](const Vec3& guess) {
    const double bound = certify(problem, guess);
    if (bound < best_bound) {
      best_bound = bound;
      best = guess;
    }
    return best_bound <= params.tolerance;
  };

  int left = params.max_iterations;
  bool done = proved(y);
  if (!done) {
    left -= finish(problem, left, y);
    done = proved(y);
  }
  // Cold again: a start on the edge of the unit balls can jam the Newton below.
  if (!done) {
    y.setZero();
    for (Term& term : problem.terms) term.z.setZero();
  }
  double gamma = kFirstGamma;
  while (!done && left > 0) {
    left -= minimiseEnvelope(problem, gamma, left, y);
    for (Term& term : problem.terms) {
      setMultiplier(term.z + project(term, y - term.a) / gamma, term);
    }
    done = proved(y);
    gamma = std::max(kGammaFactor * gamma, kLastGamma);
  }
  result.iterations = params.max_iterations - left;
  result.offset = problem.offset(best);
  result.error_bound = problem.length * best_bound;
  if (!done) result.status = SolveStatus::kIterationLimit;
}

/// The balance of one primitive and a spring that ends at `spring`: the soft threshold, exact. Sets
/// the multiplier. Off the kink y - a keeps the direction of d to the last digit, however small.
Vec3 balanceOne(const Vec3& spring, Term& term) noexcept {
  const Vec3 d = project(term, spring - term.a);
  const Vec3 foot = term.kind == PrimitiveKind::kPoint ? term.a : Vec3(spring - d);
  const double r = d.norm();
  setMultiplier(d / term.sigma, term);
  return r > term.sigma ? Vec3(foot + ((r - term.sigma) / r) * d) : foot;
}

/// The balance of a plane and one other primitive: a scalar equation. The plane's force shifts the
/// spring's end for the other, whose balance is known; the plane's own condition (y before it: no
/// force; on it; behind it: all force) is monotone in that force. Bracketed, by Chandrupatla's mix
/// of inverse quadratic interpolation and bisection. Returns the balances evaluated.
int balancePair(Term& plane, Term& other, const Vec3& spring, Vec3& y) noexcept {
  constexpr int kMost = 60;
  constexpr double kOnPlane = 4.0 * kEpsilon;
  double zeta = 1.0;  // the plane's multiplier along its normal, -1 to 1
  int evaluations = 0;
  const auto height = [&](double z) {
    ++evaluations;
    zeta = z;
    y = balanceOne(spring - plane.sigma * z * plane.q, other);
    return plane.q.dot(y - plane.a);
  };
  const auto settled = [&](bool on) {
    plane.on = on;
    plane.z = zeta * plane.q;
    return evaluations;
  };
  double a = 1.0;
  double at_a = height(a);
  if (at_a >= 0.0) return settled(false);
  double b = -1.0;
  double at_b = height(b);
  if (at_b <= 0.0) return settled(false);

  // a is the newest point, b the other end of the bracket, c the point before.
  double t = at_a / (at_a - at_b);
  while (evaluations < kMost) {
    const double z = a + t * (b - a);
    const double h = height(z);
    if (std::abs(h) <= kOnPlane) break;
    const bool same_side = (h > 0.0) == (at_a > 0.0);
    const double c = same_side ? a : b;
    const double at_c = same_side ? at_a : at_b;
    if (!same_side) {
      b = a;
      at_b = at_a;
    }
    a = z;
    at_a = h;
    const double shortest = kEpsilon / std::abs(b - a);
    if (shortest > 0.5) break;
    const double xi = (a - b) / (c - b);
    const double phi = (at_a - at_b) / (at_c - at_b);
    if (phi * phi < xi && (1.0 - phi) * (1.0 - phi) < 1.0 - xi) {
      t = at_a / (at_b - at_a) * at_c / (at_b - at_c) +
          (c - a) / (b - a) * at_a / (at_c - at_a) * at_b / (at_c - at_b);
    } else {
      t = 0.5;
    }
    t = std::clamp(t, shortest, 1.0 - shortest);
  }
  return settled(true);
}

/// Two primitives of which one is a plane, as a surface with its friction or drag: the commonest
/// case of all. False, and nothing settled, where there is no plane or the certificate fails.
bool trySolvePair(Problem& problem, const SolverParams& params, SolveResult& result) noexcept {
  Term* plane = &problem.terms[0];
  Term* other = &problem.terms[1];
  if (plane->kind != PrimitiveKind::kPlane) std::swap(plane, other);
  if (plane->kind != PrimitiveKind::kPlane) return false;
  // Near both kinks nothing should be rounded to the spring's length.
  const Vec3 origin = other->a;
  problem.moveOrigin(origin);
  Vec3 y;
  const int evaluations = balancePair(*plane, *other, problem.spring, y);
  const double bound = certify(problem, y);
  if (bound <= params.tolerance) {
    result.iterations = evaluations;
    result.offset = problem.offset(y);
    result.error_bound = problem.length * bound;
    return true;
  }
  problem.moveOrigin(-origin);
  for (Term& term : problem.terms) {
    term.z.setZero();
    term.on = false;
  }
  return false;
}

bool valid(const Primitive& primitive) noexcept {
  if (!(primitive.strength >= 0.0) || !std::isfinite(primitive.strength)) return false;
  if (primitive.kind != PrimitiveKind::kForce && !primitive.position.allFinite()) return false;
  if (primitive.kind == PrimitiveKind::kPoint) return true;
  return std::abs(primitive.direction.squaredNorm() - 1.0) <= 2e-6;  // false for NaN as well
}

/// Moves directed forces into the spring's end and the rest into terms, dimensionless.
template <std::size_t Capacity>
void solveWithStorage(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                      const SolverParams& params, SolveResult& result) noexcept {
  std::array<Term, Capacity> storage;
  Problem problem{Vec3::Zero(), 0.0, Vec3::Zero(), {}};

  // max(0, t) = (t + |t|)/2: a plane is half a directed force and half a norm.
  std::size_t count = 0;
  double sum = 0.0;
  // Sizes that enter, for the rounding: the largest distance, and what forces add up to before they
  // cancel.
  double reach = 0.0;
  double pushed = 0.0;
  for (const Primitive& primitive : primitives) {
    if (primitive.strength <= 0.0) continue;
    const bool plane = primitive.kind == PrimitiveKind::kPlane;
    // Nearly unit (valid() saw to that) to unit: one Newton step, exact to 1e-12.
    const Vec3 q = (1.5 - 0.5 * primitive.direction.squaredNorm()) * primitive.direction;
    const double share = plane ? 0.5 * primitive.strength : primitive.strength;
    if (plane || primitive.kind == PrimitiveKind::kForce) {
      problem.w += (share / stiffness) * q;
      pushed += share / stiffness;
    }
    if (primitive.kind == PrimitiveKind::kForce) continue;
    Term& term = storage[count++];
    term.z.setZero();
    term.on = false;
    term.kind = primitive.kind;
    term.sigma = share;
    term.a = primitive.position - probe;
    term.q = q;
    sum += share;
    reach = std::max(reach, term.a.lpNorm<Eigen::Infinity>());
  }
  problem.terms = {storage.data(), count};
  problem.length = sum / stiffness;
  const double rounding = 8.0 * kEpsilon * (reach + pushed + problem.length);

  // Nothing but directed forces, or strengths that cannot move the proxy beyond rounding.
  if (problem.length <= rounding || problem.length < std::numeric_limits<double>::min()) {
    result.offset = problem.w;
    result.error_bound = problem.length + rounding;
    return;
  }

  // Beside the rest some may be too weak to matter: what they can move goes into the bound.
  constexpr double kNothing = 1e-20;
  const auto weak = std::remove_if(storage.begin(), storage.begin() + count,
                                   [&](const Term& t) { return t.sigma < kNothing * sum; });
  const double left_out = kNothing * problem.length * static_cast<double>(count);
  count = static_cast<std::size_t>(weak - storage.begin());
  problem.terms = {storage.data(), count};
  for (Term& term : problem.terms) {
    term.a = (term.a - problem.w) / problem.length;
    term.sigma /= sum;
  }
  if (count == 1) {
    result.offset = problem.offset(balanceOne(problem.spring, problem.terms.front()));
    result.error_bound = rounding + left_out;
    return;
  }
  result.solver = SolverKind::kGeneral;
  if (count == 2 && trySolvePair(problem, params, result)) {
    result.error_bound += rounding + left_out;
    return;
  }
  solveGeneral(problem, params, result);
  result.error_bound += rounding + left_out;
}

}  // namespace

SolveResult solveProxy(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                       const Vec3& start, const SolverParams& params) noexcept {
  constexpr std::size_t kFew = 16;
  SolveResult result;
  const bool good = probe.allFinite() && std::isfinite(stiffness) && stiffness > 0.0 &&
                    primitives.size() <= kMaxPrimitives &&
                    std::all_of(primitives.begin(), primitives.end(), valid);
  if (good) {
    // Most ticks balance a few primitives: their terms fit into a few cache lines of stack.
    if (primitives.size() <= kFew) {
      solveWithStorage<kFew>(probe, stiffness, primitives, params, result);
    } else {
      solveWithStorage<kMaxPrimitives>(probe, stiffness, primitives, params, result);
    }
  }
  // Sums and quotients of finite numbers can still overflow.
  if (!good || !result.offset.allFinite() || !std::isfinite(result.error_bound)) {
    result = {};
    result.status = SolveStatus::kBadInput;
    result.proxy = start;
    result.offset = start - probe;
    if (!result.offset.allFinite()) result.offset.setZero();
    return result;
  }
  result.proxy = probe + result.offset;
  return result;
}

}  // namespace palpate
