#include "palpate/engine/balance/friction.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>

#include "palpate/engine/balance/compliant.h"
#include "palpate/engine/balance/one_plane.h"

namespace palpate {
namespace {

using friction::Compliant;
using friction::OnePlane;

// The loads of planes and the frictions that they cause are found together:
//
//     if no plane has friction:         solveProxy; share the load among kinks that coincide
//     else if one plane, its friction, drags: closed form, or one scalar Newton   (OnePlane)
//     else give every kink the compliance c, and find x, loads and pulls with R = 0 (Compliant):
//         warm start: Newton from the last tick's active set (which planes press, which stick)
//         else homotopy: Newton at a large c, then at smaller ones, down to at most 1 um
//         else Newton from the old proxy, where the frictions stick
//         each Newton step that leaves more than 0.9 |R|: line search if it overshot, else
//             backtracking, and a jump over a fold if the followed solution ends there
//         remove or reduce c by the method of multipliers: kinks keep their loads, x moves onto
//             them
//     set each friction's strength to mu times its plane's load; solveProxy bounds the error

void writeForces(const Compliant& found, std::span<Vec3> forces) noexcept {
  for (const RoughPlane& p : found.planes()) {
    forces[p.plane] = p.load * p.q;
    if (p.line != p.plane) forces[p.line] = -Compliant::frictionOf(p) * p.pull;
  }
  for (const Pull& p : found.pulls()) forces[p.index] = -p.strength * p.pull;
}

/// Returns true if the primitives that hold at x can share the load in more than one way.
bool overdetermined(std::span<const Primitive> primitives, const Vec3& x) noexcept {
  constexpr double kHere = 1e-9;  // [m]: a primitive within this distance of x holds at x
  constexpr double kSome = 1e-6;  // smaller eigenvalues of the sum of projectors count as zero
  Mat3 held = Mat3::Zero();
  int directions = 0;
  for (const Primitive& p : primitives) {
    if (p.kind == PrimitiveKind::kForce || !(p.strength > 0.0)) continue;
    const Vec3 d = x - p.position;
    const double along = p.direction.dot(d);
    switch (p.kind) {
      case PrimitiveKind::kForce:
        break;
      case PrimitiveKind::kPoint:
        if (!(d.norm() <= kHere)) break;
        held += Mat3::Identity();
        directions += 3;
        break;
      case PrimitiveKind::kLine:
        if (!((d - along * p.direction).norm() <= kHere)) break;
        held += friction::acrossOf(p.direction);
        directions += 2;
        break;
      case PrimitiveKind::kPlane:
        if (!(std::abs(along) <= kHere)) break;
        held += p.direction * p.direction.transpose();
        directions += 1;
        break;
    }
  }
  if (directions < 2) return false;
  if (directions > 3) return true;
  Eigen::SelfAdjointEigenSolver<Mat3> eigen;
  eigen.computeDirect(held, Eigen::EigenvaluesOnly);
  return directions > (eigen.eigenvalues().array() > kSome).count();
}

/// Solves a set without friction. If loads are not unique and Newton's method converges, their sum
/// |f|^2/s is the least possible.
SolveResult solveSmooth(const Vec3& probe, double stiffness, const PrimitiveSet& set,
                        const Vec3& proxy, const SolverParams& params, WarmStart& warm,
                        FrictionStart& start, std::span<Vec3> forces) noexcept {
  start.forget();
  SolveResult result = solveProxy(probe, stiffness, set.items(), proxy, params, &warm, forces);
  if (result.solver == SolverKind::kClosedForm || result.status == SolveStatus::kBadInput ||
      !overdetermined(set.items(), result.proxy)) {
    return result;
  }
  Compliant found(probe, stiffness, set, proxy, params.max_iterations, start);
  found.beginAt(result.proxy - proxy);
  if (found.loadsAt(result.proxy - proxy)) writeForces(found, forces);
  result.iterations += found.solves();
  return result;
}

/// Converts the balance of the compliant kinks to a warm start of solveProxy.
void tell(const Compliant& found, const PrimitiveSet& set, WarmStart& warm) noexcept {
  if (warm.multipliers.size() < set.size()) return;
  for (const RoughPlane& p : found.planes()) {
    warm.multipliers[p.plane] = (1.0 - 2.0 * p.load / p.strength) * p.q;
    if (p.line != p.plane) warm.multipliers[p.line] = p.pull;
  }
  for (const Pull& p : found.pulls()) warm.multipliers[p.index] = p.pull;
  warm.motion = found.place();
  warm.count = set.size();
}

}  // namespace

SolveResult solveWithFriction(const Vec3& probe, double stiffness, PrimitiveSet& set,
                              const Vec3& proxy, const SolverParams& params, WarmStart& warm,
                              FrictionStart& start, std::span<Vec3> forces) noexcept {
  const auto links = set.links();
  const auto items = set.items();
  if (links.empty()) {
    return solveSmooth(probe, stiffness, set, proxy, params, warm, start, forces);
  }
  for (const FrictionLink& link : links) set.setStrength(link, 0.0);
  // solveProxy reports bad input; the code below relies on good input.
  const bool good =
      proxy.allFinite() && probe.allFinite() && stiffness > 0.0 && std::isfinite(stiffness);
  if (good && OnePlane::fits(set)) {
    OnePlane one(probe, stiffness, set);
    if (one.solve()) {
      SolveResult result = one.tell(probe, set, forces);
      start.forget();
      warm.forget();
      warm.motion = result.proxy - proxy;
      const auto told = forces.first(set.size());
      const bool finite =
          result.offset.allFinite() && std::isfinite(result.error_bound) &&
          std::isfinite(items[links[0].line].strength) &&
          std::all_of(told.begin(), told.end(), [](const Vec3& f) { return f.allFinite(); });
      if (finite) return result;
    }
  }
  if (!good) {
    start.forget();
    return solveProxy(probe, stiffness, items, proxy, params, &warm, forces);
  }
  Compliant search(probe, stiffness, set, proxy, params.max_iterations, start);
  const bool found = search.solve();
  if (!found) search.goToBest();
  const bool remembered = start.count == links.size();
  for (const RoughPlane& p : search.planes()) {
    if (p.line == p.plane) continue;
    const double most = p.coefficient * p.strength;
    const double last = remembered ? std::min(start.held[p.link], most) : 0.0;
    const double wanted = Compliant::frictionOf(p);
    set.setStrength(links[p.link], found ? wanted : std::max(wanted, last));
  }
  tell(search, set, warm);
  start.motion = search.place();
  SolveResult result = solveProxy(probe, stiffness, items, proxy, params, &warm, forces);
  result.iterations += search.solves();
  if (result.status == SolveStatus::kBadInput) {
    start.forget();
    return result;
  }
  start.count = links.size();
  for (std::size_t i = 0; i < links.size(); ++i) start.held[i] = items[links[i].line].strength;
  if (!found) {
    result.status = SolveStatus::kIterationLimit;
    start.plane_count = 0;  // the next search starts without the pieces of this one
  } else {
    // The result is the solution of `search`, whose frictions satisfy Coulomb's law. Its bound
    // includes the distance to the balance with the strengths in the set.
    const Vec3 offset = search.place() + (proxy - probe);
    result.error_bound += (offset - result.offset).norm();
    result.error_bound += search.missing() / stiffness;
    result.offset = offset;
    result.proxy = proxy + search.place();
    writeForces(search, forces);
  }
  for (const FrictionLink& link : links) {
    const double load = items[link.plane].direction.dot(forces[link.plane]);
    result.error_bound += std::abs(link.coefficient * load - items[link.line].strength) / stiffness;
  }
  return result;
}

}  // namespace palpate
