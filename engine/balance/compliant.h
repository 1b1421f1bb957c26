/// Private to engine/balance: finds the balance of several frictions by Newton's method. A kink is
/// a plane, line or point at which a primitive's force jumps. In this file each force rises over a
/// short distance, the compliance of the kink. At the end, the search removes or reduces the
/// compliance.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>

#include <Eigen/LU>

#include "palpate/engine/balance/friction.h"
#include "palpate/engine/balance/one_plane.h"
#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/types.h"

namespace palpate::friction {

inline constexpr double kCompliance = 1e-6;  // largest final compliance c of a kink [m]
// a place is a solution if |R| (friction.h) is at most this share of the sum of strengths, or at
// most the rounding of R (enoughAt)
inline constexpr double kEnough = 1e-10;
// the same limit while a search reduces the compliance
inline constexpr double kRoughly = 1e-6;
inline constexpr double kUnbounded = std::numeric_limits<double>::infinity();

inline Mat3 acrossOf(const Vec3& q) noexcept {
  return Mat3::Identity() - q * q.transpose();
}
/// Returns beta(v), the point of the unit ball that is nearest to v.
inline Vec3 inBall(const Vec3& v) noexcept {
  const double length = v.norm();
  return length > 1.0 ? Vec3(v / length) : v;
}
/// Returns the derivative of v/m by v. T projects on the possible directions of v. If the kink
/// sticks, m is constant. If it slips, m counts as |v|, and the dual b replaces one factor v/|v|.
inline Mat3 turnOf(const Mat3& T, const Vec3& b, const Vec3& v, double m, bool sticks) noexcept {
  const double length = v.norm();
  if (sticks || !(length > 0.0)) return T / m;
  return (T - b * (v / length).transpose()) / m;
}

/// Searches for the balance in which every kink has the compliance c. All places in it are relative
/// to the old proxy; the constructor's `probe` and the set are in W.
class Compliant {
 public:
  Compliant(const Vec3& probe, double stiffness, const PrimitiveSet& set, const Vec3& proxy,
            int most, FrictionStart& memory) noexcept
      : stiffness_(stiffness), spring_(probe - proxy), memory_(memory), most_(most) {
    const auto links = set.links();
    const auto items = set.items();
    known_ = memory.count == links.size();
    std::size_t planes = 0;
    std::size_t pulls = 0;
    // links are in the order of their planes, and each line follows its plane
    std::size_t next = 0;
    double reach = 0.0;
    for (std::size_t i = 0; i < items.size(); ++i) {
      const Primitive& p = items[i];
      const Vec3 at = p.position - proxy;
      const bool rough = next < links.size() && links[next].plane == i;
      const std::size_t link = next;
      const std::size_t source = i;
      if (rough) {
        ++i;
        ++next;
      }
      if (!(p.strength > 0.0)) continue;
      if (p.kind == PrimitiveKind::kForce) {
        spring_ += p.strength / stiffness * p.direction;
        continue;
      }
      const Vec3 q = p.direction.normalized();
      strengths_ += p.strength;
      reach = std::max(reach, at.lpNorm<Eigen::Infinity>());
      if (p.kind == PrimitiveKind::kPlane) {
        RoughPlane& plane = memory.planes[planes++];
        plane.q = q;
        plane.foot = q.dot(at);
        plane.strength = p.strength;
        plane.coefficient = rough ? links[link].coefficient : 0.0;
        plane.grip = rough ? Vec3(items[links[link].line].position - proxy) : Vec3(Vec3::Zero());
        plane.plane = source;
        plane.line = rough ? links[link].line : source;
        plane.link = link;
        strengths_ += plane.coefficient * p.strength;
      } else {
        Pull& pull = memory.pulls[pulls++];
        pull.q = q;
        pull.at = at;
        pull.strength = p.strength;
        pull.line = p.kind == PrimitiveKind::kLine;
        pull.index = source;
      }
    }
    known_ = known_ && planes == memory.plane_count && pulls == memory.pull_count;
    memory.plane_count = planes;
    memory.pull_count = pulls;
    length_ = strengths_ / stiffness;
    hard_ = std::min(kCompliance, 1e-4 * length_);
    reach = std::max(reach, spring_.lpNorm<Eigen::Infinity>());
    rounding_ = 8.0 * std::numeric_limits<double>::epsilon() * reach / hard_;
    enough_ = enoughAt(hard_);
    if (!known_) dropKept();
  }

  /// Finds loads and frictions, then removes or reduces the compliance. Returns false if the search
  /// fails.
  bool solve() noexcept {
    if (known_ && warmStart() && removeCompliance()) return true;
    dropKept();
    return (followHomotopy(most_ / 2) || startSticking()) && removeCompliance();
  }

  /// Finds how the kinks within the distance c of x share the spring's force at x. A spring with a
  /// thousandth of the stiffness and the same force at x replaces the spring. Near x its force is
  /// almost constant, so the place can move until the loads balance. Returns false if Newton's
  /// method fails; the loads are then meaningless.
  bool loadsAt(const Vec3& x) noexcept {
    constexpr double kGivesWay = 1e-3;  // stiffness of the softer spring / k
    spring_ = x + (spring_ - x) / kGivesWay;
    stiffness_ *= kGivesWay;
    return newton(hard_, kMostHard, kMostHard, enough_);
  }

  void beginAt(const Vec3& x) noexcept { goTo(x, hard_); }

  [[nodiscard]] static double frictionOf(const RoughPlane& p) noexcept {
    return p.coefficient * p.load;
  }
  [[nodiscard]] std::span<RoughPlane> planes() const noexcept {
    return {memory_.planes.data(), memory_.plane_count};
  }
  [[nodiscard]] std::span<Pull> pulls() const noexcept {
    return {memory_.pulls.data(), memory_.pull_count};
  }
  [[nodiscard]] int solves() const noexcept { return solves_; }
  [[nodiscard]] const Vec3& place() const noexcept { return x_; }
  [[nodiscard]] double missing() const noexcept { return residual().norm(); }

  void goToBest() noexcept { goTo(best_, hard_); }

 private:
  static constexpr int kMostWarm = 16;
  static constexpr int kPatience = 3;
  static constexpr int kMostHard = 12;
  static constexpr double kLess = 0.9;  // largest share of |R| that may remain after a step
  // a place is final if the last move was at most this share of S/k
  static constexpr double kThere = 1e-8;
  // smallest compliance while loads are kept, as a share of `hard_`
  static constexpr double kLeastKept = 1e-2;

  /// Returns the largest |R| that counts as a solution, as a share of S. For a small c this limit
  /// can exceed kEnough, because rounding counts more.
  [[nodiscard]] double enoughAt(double c) const noexcept {
    return std::max(kEnough, rounding_ * hard_ / c);
  }

  void dropKept() noexcept {
    least_ = kUnbounded;
    for (RoughPlane& p : planes()) {
      p.kept_load = 0.0;
      p.kept_pull.setZero();
    }
    for (Pull& p : pulls()) p.kept_pull.setZero();
  }

  /// The slip of a kink. v is the displacement from the place where the kink holds the proxy, plus
  /// c times the kept pull. m is c if the kink sticks, else max(|v|, c).
  struct Slip {
    Vec3 v;
    double m;
  };
  [[nodiscard]] Slip slipOf(const RoughPlane& p, double c) const noexcept {
    const Vec3 v = c * p.kept_pull + across(p.q, x_ - p.grip);
    return {v, p.sticks ? c : std::max(v.norm(), c)};
  }
  [[nodiscard]] Slip slipOf(const Pull& p, double c) const noexcept {
    const Vec3 v = c * p.kept_pull + from(p, x_);
    return {v, p.holds ? c : std::max(v.norm(), c)};
  }
  [[nodiscard]] static Vec3 from(const Pull& p, const Vec3& x) noexcept {
    const Vec3 d = x - p.at;
    return p.line ? across(p.q, d) : d;
  }

  /// Computes loads, pieces and the duals `read` from the present place.
  void read(double c) noexcept {
    for (RoughPlane& p : planes()) {
      const double share = p.kept_load / p.strength - (p.q.dot(x_) - p.foot) / c;
      p.piece = share <= 0.0 ? Piece::kFree : share >= 1.0 ? Piece::kYields : Piece::kHolds;
      p.load = p.strength * std::clamp(share, 0.0, 1.0);
      const Vec3 v = p.kept_pull + across(p.q, x_ - p.grip) / c;
      p.read = inBall(v);
      p.sticks = v.squaredNorm() <= 1.0;
    }
    for (Pull& p : pulls()) {
      const Vec3 v = p.kept_pull + from(p, x_) / c;
      p.read = inBall(v);
      p.holds = v.squaredNorm() <= 1.0;
    }
  }
  /// Sets the duals to those that read() computed from the place.
  void believePlace() noexcept {
    for (RoughPlane& p : planes()) p.pull = p.read;
    for (Pull& p : pulls()) p.pull = p.read;
  }
  void goTo(const Vec3& x, double c) noexcept {
    x_ = x;
    read(c);
    believePlace();
  }

  /// Returns R(x) at the place of the last read() [N].
  [[nodiscard]] Vec3 residual() const noexcept {
    Vec3 R = stiffness_ * (spring_ - x_);
    for (const RoughPlane& p : planes()) R += p.load * (p.q - p.coefficient * p.read);
    for (const Pull& p : pulls()) R -= p.strength * p.read;
    return R;
  }

  /// Makes one Newton step with the present pieces and duals. Returns false if it is not finite.
  bool step(double c) noexcept {
    Mat3 J = stiffness_ * Mat3::Identity();
    Vec3 R = stiffness_ * (spring_ - x_);
    for (const RoughPlane& p : planes()) {
      if (p.piece == Piece::kFree) continue;
      const Vec3 push = p.q - p.coefficient * p.pull;
      double load = p.strength;
      if (p.piece == Piece::kHolds) {
        // Unlike p.load, `load` is not clamped, because Newton's method needs the linear function.
        load = p.kept_load - p.strength * (p.q.dot(x_) - p.foot) / c;
        J += p.strength / c * push * p.q.transpose();
      }
      R += load * push;
      if (!(p.coefficient > 0.0)) continue;
      const double friction = p.coefficient * std::max(p.load, 1e-9 * p.strength);
      const auto [v, m] = slipOf(p, c);
      J += friction * turnOf(acrossOf(p.q), p.pull, v, m, p.sticks);
      R -= friction * (v / m - p.pull);
    }
    for (const Pull& p : pulls()) {
      const auto [v, m] = slipOf(p, c);
      const Mat3 T = p.line ? acrossOf(p.q) : Mat3(Mat3::Identity());
      J += p.strength * turnOf(T, p.pull, v, m, p.holds);
      R -= p.strength / m * v;
    }
    const Vec3 d = J.partialPivLu().solve(R);
    turned_ = J.determinant() < 0.0;
    ++solves_;
    if (!d.allFinite()) return false;
    const auto moved = [&](const Vec3& b, const Vec3& v, const Vec3& dv, double m, bool sticks) {
      const double length = std::max(v.norm(), std::numeric_limits<double>::min());
      const double along = sticks ? 0.0 : v.dot(dv) / length;
      return inBall((v + dv - along * b) / m);
    };
    for (RoughPlane& p : planes()) {
      if (!(p.coefficient > 0.0)) continue;
      const auto [v, m] = slipOf(p, c);
      p.pull = moved(p.pull, v, across(p.q, d), m, p.sticks);
    }
    for (Pull& p : pulls()) {
      const auto [v, m] = slipOf(p, c);
      p.pull = moved(p.pull, v, p.line ? across(p.q, d) : d, m, p.holds);
    }
    x_ += d;
    return true;
  }

  /// Moves to from + t d, calls read(), and returns R.d there.
  double slopeAt(double c, const Vec3& from, const Vec3& d, double t) noexcept {
    x_ = from + t * d;
    read(c);
    return residual().dot(d);
  }

  /// If a step overshot, shortens it to where |R.d| is at most a tenth of its value at the start,
  /// as far as 40 trials find this place. Returns false if the step did not overshoot.
  bool shortenOvershoot(double c, const Vec3& from, const Vec3& d) noexcept {
    const double end = slopeAt(c, from, d, 1.0);
    const double start = slopeAt(c, from, d, 0.0);
    if (!(start > 0.0) || !(end < -0.1 * start)) return false;
    double low = 0.0;
    double high = 1.0;
    double at_low = start;
    double at_high = end;
    for (int i = 0; i < 40 && high - low >= 1e-14; ++i) {
      const double t =
          i % 3 == 2 ? 0.5 * (low + high) : low + (high - low) * at_low / (at_low - at_high);
      const double here = slopeAt(c, from, d, t);
      if (std::abs(here) <= 0.1 * start) break;
      (here > 0.0 ? low : high) = t;
      (here > 0.0 ? at_low : at_high) = here;
    }
    return true;
  }

  /// Halves the step until |R| is at most kLess times its value at the start of the step. Returns
  /// false after six halvings.
  bool backtrack(double c, const Vec3& from, const Vec3& d, double start) noexcept {
    Vec3 part = 0.5 * d;
    for (int i = 0; i < 6; ++i, part *= 0.5) {
      x_ = from + part;
      read(c);
      if (missing() <= kLess * start) return true;
    }
    return false;
  }

  /// Jumps over a fold: a place at which the solution that Newton's method followed ceases to
  /// exist. There the determinant of J changes its sign, and Newton's method converges to a minimum
  /// of |R| above zero. This function moves against Newton's step until the sign changes again.
  /// Another solution begins there (Branin 1972). Returns false if that place is not found.
  bool crossFold(double c, const Vec3& from, const Vec3& d) noexcept {
    Vec3 onwards = -d;
    for (int i = 0; i < 7 && solves_ < most_; ++i, onwards *= 2.0) {
      goTo(from + onwards, c);
      if (!step(c)) return false;
      if (turned_) continue;
      read(c);
      return true;
    }
    return false;
  }

  /// Runs Newton's method at compliance c until |R| <= enough S. The first step uses the present
  /// pieces. Returns false in these cases: `most` steps (after the first fold, kMostHard - 1 more),
  /// or the solves of the search, are used up; `patience` successive steps do not halve the least
  /// |R|; a step is not finite.
  bool newton(double c, int most, int patience, double enough) noexcept {
    double last = kUnbounded;
    double least = kUnbounded;
    int idle = 0;
    bool crossed = false;
    for (int i = 0; i < most && solves_ < most_; ++i) {
      const Vec3 from = x_;
      if (!step(c)) return false;
      const Vec3 d = x_ - from;
      read(c);
      double now = missing();
      if (i > 0 && !(now <= kLess * last)) {
        const bool nearer = shortenOvershoot(c, from, d) || backtrack(c, from, d, last);
        if (nearer || (turned_ && crossFold(c, from, d))) {
          believePlace();
          if (!nearer && !crossed) {
            crossed = true;
            most = i + kMostHard;
            idle = 0;
            least = kUnbounded;
          }
        } else {
          x_ = from + d;
          read(c);
        }
        now = missing();
      }
      if (c <= hard_ && now < least_) {
        least_ = now;
        best_ = x_;
      }
      last = now;
      if (now < 0.5 * least) {
        least = now;
        idle = 0;
      } else if (++idle >= patience) {
        return false;
      }
      if (now <= enough * strengths_) {
        believePlace();
        return true;
      }
    }
    return false;
  }

  /// Starts from the pieces and kept values of the last tick, rotated with their planes and lines.
  /// Returns false if Newton's method fails.
  bool warmStart() noexcept {
    const auto turned = [](const Vec3& q, const Vec3& b, bool sticks) {
      const Vec3 v = across(q, b);
      const double length = v.norm();
      return sticks || !(length > 0.0) ? v : Vec3(v / length);
    };
    x_ = memory_.motion;
    for (RoughPlane& p : planes()) {
      p.pull = turned(p.q, p.pull, p.sticks);
      p.kept_pull = across(p.q, p.kept_pull);
      p.kept_load = std::min(p.kept_load, p.strength);
    }
    for (Pull& p : pulls()) {
      if (!p.line) continue;
      p.pull = turned(p.q, p.pull, p.holds);
      p.kept_pull = across(p.q, p.kept_pull);
    }
    return newton(hard_, kMostWarm, kPatience, enough_);
  }

  /// Reduces a large compliance step by step. Returns false if it does not reach `hard_`.
  bool followHomotopy(int until) noexcept {
    constexpr int kEach = 8;
    double c = 0.3 * length_;
    goTo(spring_, c);
    if (!newton(c, 20, 20, 1e-4)) {
      c = 30.0 * length_;
      goTo(spring_, c);
      if (!newton(c, 30, 30, kRoughly)) return false;
    }
    constexpr double kShortest = 0.97;
    constexpr double kLongest = 0.03;
    double ratio = kLongest;
    while (c > hard_ && solves_ < until) {
      const double next = std::max(hard_, ratio * c);
      const Vec3 before = x_;
      if (newton(next, kEach, kEach, next <= hard_ ? enough_ : kRoughly)) {
        c = next;
        ratio = std::max(kLongest, ratio * ratio);
      } else {
        goTo(before, c);
        ratio = std::sqrt(ratio);
        if (ratio > kShortest) break;
      }
    }
    return c <= hard_;
  }

  /// Starts from the old proxy, where the frictions stick. Tries up to three first compliances.
  /// Returns false if the search reaches no balance at `hard_`.
  bool startSticking() noexcept {
    for (const double soft : {0.0, 1e-4, 1e-2}) {
      double c = std::max(hard_, soft * length_);
      goTo(Vec3::Zero(), c);
      bool good = newton(c, 12, 12, c <= hard_ ? enough_ : kRoughly);
      while (good && c > hard_) {
        c = std::max(hard_, 0.1 * c);
        good = newton(c, 8, 8, c <= hard_ ? enough_ : kRoughly);
      }
      if (good) return true;
    }
    return false;
  }

  /// Removes the compliance by the method of multipliers: a kink keeps the load that it bears, and
  /// the place moves onto the kink. A smaller c makes this faster. A slipping friction keeps its
  /// pull as well; otherwise, when a proxy comes to rest, its friction would alternate between
  /// sticking and slipping. The method may not converge if frictions press each other's planes;
  /// then only c is reduced. Returns false if the place was found with values kept from the last
  /// tick, and no solution is near it without them.
  bool removeCompliance() noexcept {
    constexpr int kRounds = 8;
    const Vec3 soft = x_;
    double c = hard_;
    for (int round = 0; round < kRounds; ++round) {
      const Vec3 before = x_;
      for (RoughPlane& p : planes()) {
        p.kept_load = p.load;
        p.kept_pull = p.pull;
      }
      for (Pull& p : pulls()) p.kept_pull = p.holds ? p.pull : Vec3(Vec3::Zero());
      if (!newton(c, kMostHard, kMostHard, enoughAt(c))) break;
      if ((x_ - before).norm() <= kThere * length_) return true;
      c = std::max(kLeastKept * hard_, 0.1 * c);
    }
    dropKept();
    goTo(soft, hard_);
    if (!newton(hard_, kMostHard, kPatience, enough_)) return false;
    c = hard_;
    for (const double share : {0.1, 0.01, 1e-3}) {
      const Vec3 before = x_;
      if (!newton(share * hard_, kMostHard, kMostHard, enoughAt(share * hard_))) {
        goTo(before, c);
        break;
      }
      c = share * hard_;
    }
    return true;
  }

  double stiffness_;
  Vec3 spring_;  ///< End of the spring, displaced by directed forces.
  FrictionStart& memory_;
  double strengths_ = 0.0;  ///< The sum of strengths, S [N].
  double length_ = 0.0;     ///< S/k [m].
  double hard_ = 0.0;       ///< The compliance to reach [m].
  double enough_ = 0.0;
  bool turned_ = false;  ///< True if the determinant in the last step was below zero.
  /// Part of |R| that rounding causes at the compliance `hard_`, as a share of S.
  double rounding_ = 0.0;
  bool known_ = false;
  Vec3 x_ = Vec3::Zero();
  Vec3 best_ = Vec3::Zero();
  double least_ = kUnbounded;
  int most_;
  int solves_ = 0;
};

}  // namespace palpate::friction
