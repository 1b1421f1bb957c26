#include "palpate/engine/balance/solver.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Geometry>

#include "palpate/engine/balance/multipliers.h"
#include "palpate/engine/balance/pair.h"
#include "palpate/engine/balance/pivots.h"
#include "palpate/engine/balance/terms.h"

namespace palpate {
namespace {

using namespace solver;

// Method. The unit of length is T/k and the unit of force is T. T is the sum of the strengths of
// points and lines, and of half the strengths of planes. The potential of solver.h becomes
//
//     |y - spring|^2 / 2 + sum sigma |P y - b|,   sum sigma = 1.
//
//     eq. (8)         moves the spring's end, and needs no term
//     eq. (9)         P = I
//     eqs (10), (11)  P = I - q q^T
//     eqs (12), (13)  max(0, t) = (t + |t|)/2: half of it as eq. (8), half with P = q q^T
//     eq. (14)        minus the gradient; on a kink, where P y = b, any -sigma z with |z| <= 1
//     eq. (15)        y, and a z for each primitive, with gradient zero
//
// balanceFew() balances at most one primitive. balance() tries the methods in this order: up to
// three orthogonal primitives one by one; a plane and one other primitive (pair.h); planes alone
// (pivots.h); Newton on the primitives that held the proxy in the last tick, then the method of
// multipliers (multipliers.h). Except for a single primitive and orthogonal primitives, each result
// has a proved error bound (certificate.h, Pair::bound). docs/decisions/0005 and 0012 give the
// reasons.

/// Returns true if the product of every two projectors is zero, within rounding.
bool orthogonal(const Terms& terms) noexcept {
  constexpr double kNothing = 1e-30;
  for (std::size_t i = 1; i < terms.count; ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      // One primitive must be a plane, and the other's projector must map its normal to zero.
      const std::size_t plane = terms.alpha[i] == 0.0 ? i : j;
      const std::size_t other = plane == i ? j : i;
      if (terms.alpha[plane] != 0.0) return false;
      if (project(terms, other, get(terms.q, plane)).squaredNorm() > kNothing) return false;
    }
  }
  return true;
}

/// Balances orthogonal primitives in closed form: each acts as if it were alone. Eq. (2) is correct
/// only in this case.
Vec3 balanceOrthogonal(const Problem& problem) noexcept {
  const Terms& terms = problem.terms;
  Vec3 pull = Vec3::Zero();
  for (std::size_t i = 0; i < terms.count; ++i) {
    const Vec3 d = project(terms, i, problem.spring) - get(terms.b, i);
    const double r = d.norm();
    // On its kink, a primitive cancels all of d; off its kink, as much as its strength allows.
    pull += r > terms.sigma[i] ? Vec3((terms.sigma[i] / r) * d) : d;
    set(terms.z, i, d / std::max(r, terms.sigma[i]));
  }
  return problem.w - problem.length * pull;
}

/// Normalises a nearly unit vector by two Newton steps. The first step has an error below 2e-12.
Vec3 unit(const Vec3& q) noexcept {
  const double once = 1.5 - 0.5 * q.squaredNorm();
  return (once * (1.5 - 0.5 * once * once * q.squaredNorm())) * q;
}

/// Returns true if planes i and i + 1 are opposed, with the same place and strength. Together they
/// are a slab, s |q.(x - x_i)|: one norm without a constant force.
bool slab(std::span<const Primitive> primitives, std::size_t i) noexcept {
  if (i + 1 >= primitives.size()) return false;
  const Primitive& a = primitives[i];
  const Primitive& b = primitives[i + 1];
  return a.kind == PrimitiveKind::kPlane && b.kind == PrimitiveKind::kPlane &&
         a.strength == b.strength && a.position == b.position && a.direction == -b.direction;
}

/// Returns the strength of a primitive's norm [N]; for a plane half, as max(0, t) = (t + |t|)/2.
double share(const Primitive& primitive) noexcept {
  switch (primitive.kind) {
    case PrimitiveKind::kPoint:
    case PrimitiveKind::kLine:
      return primitive.strength;
    case PrimitiveKind::kPlane:
      return 0.5 * primitive.strength;
    case PrimitiveKind::kForce:
      break;
  }
  return 0.0;
}

struct Remainder {
  Vec3 origin = Vec3::Zero();  ///< origin of the terms, from the probe [m]
  double bound = 0.0;  ///< largest effect of rounding and of omitted primitives on the result [m]
};

/// Makes the problem from eqs (8) to (13). `terms` stays empty if only directed forces matter.
Problem makeProblem(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                    const Terms& storage, Remainder& remainder) noexcept {
  Problem problem;
  problem.terms = storage;

  // The bound on rounding uses the largest distance of an anchor, `reach` [m], and the sum of
  // |directed force| / k, `pushed` [m].
  const double per_stiffness = 1.0 / stiffness;
  double sum = 0.0;
  double reach = 0.0;
  double pushed = 0.0;
  double pushes = 0.0;
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    const Primitive& p = primitives[i];
    if (!(p.strength > 0.0)) continue;
    const bool both = slab(primitives, i);
    const double norm = both ? p.strength : share(p);
    const double force = p.strength - norm;
    sum += norm;
    if (force > 0.0) {
      problem.w += (force * per_stiffness) * unit(p.direction);
      pushed += force * per_stiffness;
      pushes += 1.0;
    }
    if (norm > 0.0) reach = std::max(reach, (p.position - probe).lpNorm<Eigen::Infinity>());
    if (both) ++i;
  }
  problem.length = sum * per_stiffness;
  remainder.bound = 8.0 * kEpsilon * (reach + problem.length) + (8.0 + pushes) * kEpsilon * pushed;

  // If the strengths cannot move the proxy by more than rounding, they enter only the bound.
  if (problem.length <= remainder.bound || problem.length < std::numeric_limits<double>::min()) {
    remainder.bound += problem.length;
    return problem;
  }

  // The origin is the anchor nearest to the spring's end, so that kinks with a common anchor
  // coincide to the last digit. If no anchor is within T/k of the spring's end, the origin is that
  // end. The bound includes the effect of omitted weak primitives.
  constexpr double kNothing = 1e-20;
  Terms& terms = problem.terms;
  remainder.origin = problem.w;
  double nearest = problem.length * problem.length;
  const double per_sum = 1.0 / sum;
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    const Primitive& p = primitives[i];
    const bool both = slab(primitives, i);
    const double norm = both ? p.strength : share(p);
    const std::size_t source = i;
    if (both) ++i;
    if (!(norm > 0.0)) continue;
    if (norm < kNothing * sum) {
      remainder.bound += kNothing * problem.length;
      continue;
    }
    const bool plane = p.kind == PrimitiveKind::kPlane;
    const bool point = p.kind == PrimitiveKind::kPoint;
    const Vec3 anchor = p.position - probe;
    const double distance = (anchor - problem.w).squaredNorm();
    if (distance < nearest) {
      nearest = distance;
      remainder.origin = anchor;
    }
    const std::size_t n = terms.count++;
    terms.source[n] = source;
    terms.sigma[n] = norm * per_sum;
    terms.alpha[n] = plane ? 0.0 : 1.0;
    terms.beta[n] = plane ? 1.0 : (point ? 0.0 : -1.0);
    set(terms.q, n, point ? Vec3(Vec3::Zero()) : unit(p.direction));
    set(terms.b, n, anchor);
  }
  const double per_length = 1.0 / problem.length;
  terms.placeFeet(remainder.origin, per_length);
  problem.spring = per_length * (problem.w - remainder.origin);
  return problem;
}

void balanceGeneral(Problem& problem, const Vec3& guess, std::size_t count,
                    const SolverParams& params, WarmStart* warm, SolveResult& result) noexcept {
  result.solver = SolverKind::kGeneral;
  const Terms& terms = problem.terms;
  Search search(problem, params);
  Vec3 from = guess;
  bool done = false;
  int pivots = 0;
  if (Pivots::fits(terms)) {
    Pivots planes(problem);
    const bool known = warm != nullptr && warm->count == count && guess.allFinite();
    Vec3 y = known ? guess : problem.spring;
    const bool solved = planes.solve(y);
    done = search.prove(y);
    if (solved && !done) {
      search.moveOrigin(y);
      from -= y;
      done = search.prove(planes.onHeld());
    }
    pivots = planes.pivots();
  }
  if (!done && warm != nullptr && warm->count == count && guess.allFinite()) {
    for (std::size_t i = 0; i < terms.count; ++i) {
      set(terms.z, i, warm->multipliers[terms.source[i]]);
    }
    problem.terms.turnMultipliers();
    done = search.warm(from);
  }
  if (!done) done = search.cold();
  if (!done) result.status = SolveStatus::kIterationLimit;
  result.iterations = pivots + search.solves();
  result.offset = search.offset();
  result.error_bound = search.bound();
  if (warm == nullptr) return;
  warm->count = done ? count : 0;
  for (std::size_t i = 0; done && i < terms.count; ++i) {
    warm->multipliers[terms.source[i]] = get(terms.z, i);
  }
}

/// Writes the force of each primitive on the proxy [N]: its constant part plus -sigma z.
void writeForces(const Terms& terms, std::span<const Primitive> primitives,
                 std::span<Vec3> forces) noexcept {
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    const Primitive& p = primitives[i];
    const double constant = p.strength - share(p);
    const bool pushes = p.kind == PrimitiveKind::kForce || p.kind == PrimitiveKind::kPlane;
    forces[i] = pushes ? Vec3(constant * unit(p.direction)) : Vec3(Vec3::Zero());
  }
  for (std::size_t i = 0; i < terms.count; ++i) {
    const std::size_t source = terms.source[i];
    const Primitive& p = primitives[source];
    const Vec3 z = get(terms.z, i);
    if (slab(primitives, source)) {
      // The plane that the proxy is pressed against carries the load.
      forces[source] = forces[source + 1] = Vec3::Zero();
      forces[p.direction.dot(z) > 0.0 ? source + 1 : source] = -p.strength * z;
    } else {
      forces[source] -= share(p) * z;
    }
  }
}

template <std::size_t Capacity>
void balance(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
             const Vec3& start, const SolverParams& params, WarmStart* warm, std::span<Vec3> forces,
             SolveResult& result) noexcept {
  Storage<Capacity> storage;
  Remainder remainder;
  Problem problem = makeProblem(probe, stiffness, primitives, storage.view(), remainder);
  const std::size_t count = problem.terms.count;
  // The tolerance cannot be less than the rounding of the input.
  SolverParams wanted = params;
  const double least = remainder.bound / problem.length;
  wanted.tolerance = params.tolerance > least ? params.tolerance : least;

  if (count == 0) {
    result.offset = problem.w;
  } else if (count <= 3 && orthogonal(problem.terms)) {
    result.offset = balanceOrthogonal(problem);
  } else if (count == 2 && trySolvePair(problem, wanted, result)) {
    result.solver = SolverKind::kPair;
  } else {
    // The guess assumes that the proxy moves as in the last tick.
    Vec3 guess = Vec3::Zero();
    if (warm != nullptr) guess = start - probe + warm->motion - remainder.origin;
    balanceGeneral(problem, guess / problem.length, primitives.size(), wanted, warm, result);
  }
  result.error_bound += remainder.bound;
  if (!forces.empty()) writeForces(problem.terms, primitives, forces);
  if (warm == nullptr) return;
  if (result.solver != SolverKind::kGeneral) warm->forget();
  warm->motion = probe + result.offset - start;
}

/// Balances at most one primitive without the general setup.
SolveResult balanceFew(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                       const Vec3& start, WarmStart* warm, std::span<Vec3> forces) noexcept {
  SolveResult result;
  if (!primitives.empty()) {
    const Primitive& p = primitives[0];
    const double most = p.strength / stiffness;
    const bool free = p.kind == PrimitiveKind::kForce;
    Vec3 to = free ? Vec3(Vec3::Zero()) : Vec3(p.position - probe);
    const double reach = to.lpNorm<Eigen::Infinity>();
    const Vec3 q = p.kind == PrimitiveKind::kPoint ? Vec3(Vec3::Zero()) : unit(p.direction);
    if (free) {
      result.offset = most * q;
    } else if (p.kind == PrimitiveKind::kPlane) {
      result.offset = std::clamp(q.dot(to), 0.0, most) * q;
    } else {
      to -= q.dot(to) * q;
      const double far = to.norm();
      result.offset = far > most ? Vec3((most / far) * to) : to;
    }
    result.error_bound = 8.0 * kEpsilon * (reach + most);
    if (!forces.empty()) forces[0] = stiffness * result.offset;
  }
  if (warm != nullptr) {
    warm->forget();
    warm->motion = probe + result.offset - start;
  }
  return result;
}

}  // namespace

SolveResult solveProxy(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                       const Vec3& start, const SolverParams& params, WarmStart* warm,
                       std::span<Vec3> forces) noexcept {
  constexpr std::size_t kFew = 16;
  SolveResult result;
  const bool good = probe.allFinite() && std::isfinite(stiffness) && stiffness > 0.0 &&
                    primitives.size() <= kMaxPrimitives &&
                    (forces.empty() || forces.size() >= primitives.size()) &&
                    std::all_of(primitives.begin(), primitives.end(),
                                [](const Primitive& p) { return isValid(p); });
  if (warm != nullptr && warm->multipliers.size() < primitives.size()) warm = nullptr;
  if (good) {
    // Most ticks have few primitives. A small capacity touches 3 KB of stack instead of 130 KB.
    if (primitives.size() <= 1) {
      result = balanceFew(probe, stiffness, primitives, start, warm, forces);
    } else if (primitives.size() <= kFew) {
      balance<kFew>(probe, stiffness, primitives, start, params, warm, forces, result);
    } else {
      balance<kMaxPrimitives>(probe, stiffness, primitives, start, params, warm, forces, result);
    }
  }
  // Sums and quotients of finite numbers may still overflow.
  if (!good || !result.offset.allFinite() || !std::isfinite(result.error_bound)) {
    result = {};
    result.status = SolveStatus::kBadInput;
    result.error_bound = std::numeric_limits<double>::infinity();
    if (warm != nullptr) warm->forget();
    result.proxy = start;
    result.offset = start - probe;
    if (!result.offset.allFinite()) result.offset.setZero();
    return result;
  }
  result.proxy = probe + result.offset;
  return result;
}

}  // namespace palpate
