#include "palpate/engine/friction.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "palpate/engine/loads.h"

namespace palpate {
namespace {

/// Solves one balance after another, with trial strengths of the frictions' lines.
class Friction {
 public:
  Friction(const Vec3& probe, double stiffness, PrimitiveSet& set, const Vec3& proxy,
           const SolverParams& params, WarmStart& warm, std::span<Vec3> forces) noexcept
      : probe_(probe),
        stiffness_(stiffness),
        set_(set),
        proxy_(proxy),
        params_{std::min(params.tolerance, kTolerance), params.max_iterations},
        warm_(warm),
        forces_(forces) {}

  /// Solves the balance with the present strengths. False on bad input: no other trial would do.
  bool solve() noexcept {
    const int iterations = result_.iterations;
    result_ = solveProxy(probe_, stiffness_, set_.items(), proxy_, params_, &warm_, forces_);
    result_.iterations += iterations;
    shareLoads(probe_, set_.items(), result_, forces_);
    ++solves_;
    return result_.status != SolveStatus::kBadInput;
  }

  /// mu n - s_t of a link in the last balance [N].
  [[nodiscard]] double excess(const FrictionLink& link) const noexcept {
    const Primitive& plane = set_.items()[link.plane];
    const double load = std::clamp(plane.direction.dot(forces_[link.plane]), 0.0, plane.strength);
    return link.coefficient * load - strength(link);
  }
  [[nodiscard]] double strength(const FrictionLink& link) const noexcept {
    return set_.items()[link.line].strength;
  }
  void set(const FrictionLink& link, double strength) noexcept { set_.setStrength(link, strength); }
  /// The most that a link can hold [N].
  [[nodiscard]] double most(const FrictionLink& link) const noexcept {
    return link.coefficient * set_.items()[link.plane].strength;
  }
  /// True if s_t = mu n holds to the accuracy with which the balance knows the load.
  [[nodiscard]] bool met(const FrictionLink& link) const noexcept {
    constexpr double kRounding = 1e-12;
    // Loads that several frictions share are known only as well as the proxy's place.
    const bool several = set_.links().size() > 1;
    const double shared = several ? set_.items()[link.plane].strength / kSharedWithin : 0.0;
    const double known = link.coefficient * (stiffness_ + shared) * result_.error_bound;
    const double felt = 1e-4 + 1e-3 * strength(link);  // [N]
    return std::abs(excess(link)) <= kRounding * most(link) + std::min(known, felt);
  }
  [[nodiscard]] bool allMet() const noexcept {
    return std::all_of(set_.links().begin(), set_.links().end(),
                       [&](const FrictionLink& link) { return met(link); });
  }
  [[nodiscard]] bool spent() const noexcept {
    const bool alone = set_.links().size() == 1;
    return solves_ >= (alone ? kMostFrictionSolves : kMostJointSolves - 1) ||
           (alone ? 1 : 2) * result_.iterations >= kMostFrictionIterations;
  }

  /// Solves the law of a link that is alone, from the last balance on. False where solve() is.
  bool meet(const FrictionLink& link) noexcept {
    double low = 0.0;
    double high = most(link);
    double low_excess = 0.0;  // excess at `low`, halved as Illinois does; 0: not evaluated
    double high_excess = 0.0;
    double last = 0.0;
    double last_excess = 0.0;
    while (!met(link) && !spent()) {
      // A jump: the loads can be shared in several ways, and a share in between satisfies the law.
      if (high - low <= kJump * most(link)) {
        shared_ = true;
        return true;
      }
      const double at = strength(link);
      const double here = excess(link);
      const bool same_side = last_excess * here > 0.0;
      if (here > 0.0) {
        low = at;
        low_excess = here;
        if (same_side) high_excess *= 0.5;
      } else {
        high = at;
        high_excess = here;
        if (same_side) low_excess *= 0.5;
      }
      // The first step is exact where the load does not depend on the friction.
      double next = at + here;
      if (low_excess > 0.0 && high_excess < 0.0) {
        next = (low * high_excess - high * low_excess) / (high_excess - low_excess);
      } else if (last_excess != 0.0) {
        next = at - here * (at - last) / (here - last_excess);
      }
      if (!(next > low && next < high)) next = 0.5 * (low + high);
      last = at;
      last_excess = here;
      set(link, next);
      if (!solve()) return false;
    }
    return true;
  }

  /// Iterates all links together to the fixed point s_t = mu n, mixed with the last trial so that
  /// the slowest direction's error is extrapolated to zero (Anderson 1965, one step of memory).
  /// False where solve() is.
  bool mix(FrictionStart& start) noexcept {
    const auto links = set_.links();
    double least = std::numeric_limits<double>::infinity();
    // A link that is alone takes one step: exact where the load does not depend on the friction.
    const bool alone = links.size() == 1;
    for (int k = 0; !(alone && k > 0) && !allMet() && !spent(); ++k) {
      double worst = 0.0;
      for (const FrictionLink& link : links) worst = std::max(worst, std::abs(excess(link)));
      for (std::size_t i = 0; worst < least && i < links.size(); ++i) {
        start.best[i] = strength(links[i]);
      }
      least = std::min(least, worst);
      double dot = 0.0;
      double square = 0.0;
      for (std::size_t i = 0; k > 0 && i < links.size(); ++i) {
        const double change = excess(links[i]) - start.missed[i];
        dot += excess(links[i]) * change;
        square += change * change;
      }
      const double mixing = square > 0.0 ? dot / square : 0.0;
      for (std::size_t i = 0; i < links.size(); ++i) {
        const double at = strength(links[i]);
        const double here = excess(links[i]);
        const double last = k > 0 ? start.tried[i] + start.missed[i] : at + here;
        const double next = at + here - mixing * (at + here - last);
        start.tried[i] = at;
        start.missed[i] = here;
        set(links[i], std::clamp(next, 0.0, most(links[i])));
      }
      if (!solve()) return false;
    }
    return true;
  }

  /// After mix() failed: takes the larger of each link's last and best strength. False as solve().
  bool hold(const FrictionStart& start) noexcept {
    const auto links = set_.links();
    for (std::size_t i = 0; i < links.size(); ++i) {
      const double last = start.count == links.size() ? start.strengths[i] : 0.0;
      set(links[i], std::min(std::max(last, start.best[i]), most(links[i])));
    }
    return solve();
  }

  [[nodiscard]] SolveResult finish() noexcept {
    if (result_.status == SolveStatus::kBadInput) return result_;
    const bool jump = shared_;
    if (!jump && !allMet()) {
      result_.status = std::max(result_.status, SolveStatus::kIterationLimit);
    }
    for (const FrictionLink& link : set_.links()) {
      result_.error_bound += (jump ? kJump * most(link) : std::abs(excess(link))) / stiffness_;
    }
    return result_;
  }

 private:
  const Vec3& probe_;
  double stiffness_;
  PrimitiveSet& set_;
  const Vec3& proxy_;
  SolverParams params_;
  WarmStart& warm_;
  std::span<Vec3> forces_;
  static constexpr double kTolerance = 2e-8;  // loads are as exact as the proxy's place
  static constexpr double kJump = 1e-13;      // a bracket's width, as a share of most()
  SolveResult result_;
  int solves_ = 0;
  bool shared_ = false;  // meet() ended at a jump
};

}  // namespace

SolveResult solveWithFriction(const Vec3& probe, double stiffness, PrimitiveSet& set,
                              const Vec3& proxy, const SolverParams& params, WarmStart& warm,
                              FrictionStart& start, std::span<Vec3> forces) noexcept {
  const auto links = set.links();
  if (links.empty()) {
    start.forget();
    const SolveResult result =
        solveProxy(probe, stiffness, set.items(), proxy, params, &warm, forces);
    shareLoads(probe, set.items(), result, forces);
    return result;
  }
  Friction friction(probe, stiffness, set, proxy, params, warm, forces);
  const bool remembered = start.count == links.size();
  for (std::size_t i = 0; i < links.size(); ++i) {
    friction.set(links[i],
                 remembered ? std::min(start.strengths[i], friction.most(links[i])) : 0.0);
  }
  bool good = friction.solve();

  // Where the loads do not depend on the frictions, one step satisfies all laws.
  if (good) good = friction.mix(start);
  if (good && links.size() == 1) good = friction.meet(links[0]);
  if (good && links.size() > 1 && !friction.allMet()) good = friction.hold(start);
  start.count = good ? links.size() : 0;
  for (std::size_t i = 0; i < start.count; ++i) start.strengths[i] = friction.strength(links[i]);
  return friction.finish();
}

}  // namespace palpate
