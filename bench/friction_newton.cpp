#include "bench/friction_newton.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/LU>

namespace palpate::methods {
namespace {

constexpr double kCompliance = 1e-6;  // c [m]
constexpr double kEnough = 1e-10;     // |R| of a solution, as a share of the sum of strengths
constexpr double kThere = 5e-3;       // of c: so near loads are as good as at the place itself
constexpr double kRoughly = 1e-6;     // |R| on the way from soft to hard
constexpr double kUnbounded = std::numeric_limits<double>::infinity();

Vec3 across(const Vec3& q, const Vec3& v) noexcept {
  return v - q.dot(v) * q;
}
Mat3 acrossOf(const Vec3& q) noexcept {
  return Mat3::Identity() - q * q.transpose();
}
/// beta(v): the nearest point of the unit ball.
Vec3 inBall(const Vec3& v) noexcept {
  const double length = v.norm();
  return length > 1.0 ? Vec3(v / length) : v;
}
/// The derivative of v/m by v, m = |v| where it slips, with the dual b for v/|v|.
Mat3 turnOf(const Mat3& T, const Vec3& b, const Vec3& v, double m, bool sticks) noexcept {
  const double length = v.norm();
  if (sticks || !(length > 0.0)) return T / m;
  return (T - b * (v / length).transpose()) / m;
}

/// A balance whose every kink has the compliance c. Places are from the old proxy.
class Compliant {
 public:
  Compliant(const Vec3& probe, double stiffness, const PrimitiveSet& set, const Vec3& proxy,
            int most, NewtonStart& memory) noexcept
      : stiffness_(stiffness), spring_(probe - proxy), memory_(memory), most_(most) {
    const auto links = set.links();
    const auto items = set.items();
    known_ = memory.count == links.size();
    std::size_t planes = 0;
    std::size_t pulls = 0;
    std::size_t next = 0;  // links come in their planes' order, each line after its plane
    double reach = 0.0;
    for (std::size_t i = 0; i < items.size(); ++i) {
      const Primitive& p = items[i];
      const Vec3 at = p.position - proxy;
      const bool rough = next < links.size() && links[next].plane == i;
      const FrictionLink* link = rough ? &links[next++] : nullptr;
      const std::size_t source = i;
      if (rough) ++i;
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
        plane.coefficient = rough ? link->coefficient : 0.0;
        plane.grip = rough ? Vec3(items[link->line].position - proxy) : Vec3(Vec3::Zero());
        plane.plane = source;
        plane.line = rough ? link->line : source;
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
    const double rounding = 8.0 * std::numeric_limits<double>::epsilon() * reach / hard_;
    enough_ = std::max(kEnough, rounding);
    dropKept();
  }

  /// Finds loads and frictions; false where no way led to them.
  bool solve() noexcept { return (known_ && fromLast()) || fromSoft() || fromSticking(); }

  /// The loads by which kinks about x, less than c apart, share what balances the spring there. The
  /// place at which they are read gives way for the spring, whose end is so far off that it pulls
  /// the same everywhere. False where none are found: then loads mean nothing.
  bool loadsAt(const Vec3& x) noexcept {
    constexpr double kGivesWay = 1e-3;  // share of the stiffness that stays
    if ((x_ - x).norm() <= kThere * hard_) return true;
    spring_ = x + (spring_ - x) / kGivesWay;
    stiffness_ *= kGivesWay;
    return newton(hard_, kMostHard, kMostHard, enough_);
  }

  /// How far the loads that were found are from balancing the spring at x [N].
  [[nodiscard]] double leftOver(const Vec3& x) const noexcept {
    return missing() + stiffness_ * (x_ - x).norm();
  }

  /// Takes the compliance out: the loads stay, and the place goes onto the kinks.
  void harden() noexcept {
    const Vec3 before = x_;
    for (RoughPlane& p : planes()) {
      p.kept_load = p.load;
      p.kept_pull = p.sticks ? p.pull : Vec3(Vec3::Zero());
    }
    for (Pull& p : pulls()) p.kept_pull = p.holds ? p.pull : Vec3(Vec3::Zero());
    if (newton(hard_, kMostHard, kMostHard, enough_)) return;
    dropKept();
    goTo(before, hard_);
  }

  /// The friction of a plane [N].
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

  /// Goes to where |R| was least.
  void goToBest() noexcept { goTo(best_, hard_); }

 private:
  static constexpr int kMostWarm = 16;
  static constexpr int kPatience = 3;
  static constexpr int kMostHard = 12;

  void dropKept() noexcept {
    for (RoughPlane& p : planes()) {
      p.kept_load = 0.0;
      p.kept_pull.setZero();
    }
    for (Pull& p : pulls()) p.kept_pull.setZero();
  }

  [[nodiscard]] static Vec3 from(const Pull& p, const Vec3& x) noexcept {
    const Vec3 d = x - p.at;
    return p.line ? across(p.q, d) : d;
  }

  /// Loads, pieces and what the duals are by the place alone.
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
  /// The duals by the place alone.
  void believePlace() noexcept {
    for (RoughPlane& p : planes()) p.pull = p.read;
    for (Pull& p : pulls()) p.pull = p.read;
  }
  void goTo(const Vec3& x, double c) noexcept {
    x_ = x;
    read(c);
    believePlace();
  }

  /// R(x) of the place last read [N].
  [[nodiscard]] Vec3 residual() const noexcept {
    Vec3 R = stiffness_ * (spring_ - x_);
    for (const RoughPlane& p : planes()) R += p.load * (p.q - p.coefficient * p.read);
    for (const Pull& p : pulls()) R -= p.strength * p.read;
    return R;
  }

  /// One step of Newton with the pieces and duals as they are. False where it leads nowhere.
  bool step(double c) noexcept {
    Mat3 J = stiffness_ * Mat3::Identity();
    Vec3 R = stiffness_ * (spring_ - x_);
    for (const RoughPlane& p : planes()) {
      if (p.piece == Piece::kFree) continue;
      const Vec3 push = p.q - p.coefficient * p.pull;
      double load = p.strength;
      if (p.piece == Piece::kHolds) {
        load = p.kept_load - p.strength * (p.q.dot(x_) - p.foot) / c;  // linear, not clamped
        J += p.strength / c * push * p.q.transpose();
      }
      R += load * push;
      if (!(p.coefficient > 0.0)) continue;
      const double friction = p.coefficient * std::max(p.load, 1e-9 * p.strength);
      const Vec3 v = c * p.kept_pull + across(p.q, x_ - p.grip);
      const double m = p.sticks ? c : std::max(v.norm(), c);
      J += friction * turnOf(acrossOf(p.q), p.pull, v, m, p.sticks);
      R -= friction * (v / m - p.pull);
    }
    for (const Pull& p : pulls()) {
      const Vec3 v = c * p.kept_pull + from(p, x_);
      const double m = p.holds ? c : std::max(v.norm(), c);
      const Mat3 T = p.line ? acrossOf(p.q) : Mat3(Mat3::Identity());
      J += p.strength * turnOf(T, p.pull, v, m, p.holds);
      R -= p.strength / m * v;
    }
    const Vec3 d = J.partialPivLu().solve(R);
    ++solves_;
    if (!d.allFinite()) return false;
    const auto moved = [&](const Vec3& b, const Vec3& v, const Vec3& dv, double m, bool sticks) {
      const double length = std::max(v.norm(), std::numeric_limits<double>::min());
      const double along = sticks ? 0.0 : v.dot(dv) / length;
      return inBall((v + dv - along * b) / m);
    };
    for (RoughPlane& p : planes()) {
      if (!(p.coefficient > 0.0)) continue;
      const Vec3 v = c * p.kept_pull + across(p.q, x_ - p.grip);
      const double m = p.sticks ? c : std::max(v.norm(), c);
      p.pull = moved(p.pull, v, across(p.q, d), m, p.sticks);
    }
    for (Pull& p : pulls()) {
      const Vec3 v = c * p.kept_pull + from(p, x_);
      const double m = p.holds ? c : std::max(v.norm(), c);
      p.pull = moved(p.pull, v, p.line ? across(p.q, d) : d, m, p.holds);
    }
    x_ += d;
    return true;
  }

  /// R.d at from + t d, the place alone.
  double slopeAt(double c, const Vec3& from, const Vec3& d, double t) noexcept {
    x_ = from + t * d;
    read(c);
    return residual().dot(d);
  }

  /// Where on the step R.d has fallen to a tenth: the step overshot. False where it did not.
  bool shorten(double c, const Vec3& from, const Vec3& d) noexcept {
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

  /// Halves the step until |R| is less than at its start. False where it never is: two pieces may
  /// lead to each other.
  bool halve(double c, const Vec3& from, const Vec3& d, double start) noexcept {
    constexpr int kMost = 6;
    Vec3 part = d;
    for (int i = 0; i < kMost; ++i) {
      part *= 0.5;
      x_ = from + part;
      read(c);
      if (missing() < start) return true;
    }
    return false;
  }

  /// Newton at c until |R| <= enough S. The first step is with the pieces as they are: the last
  /// tick's, or those of the last c. False after `most` steps, or `patience` that do not halve |R|.
  bool newton(double c, int most, int patience, double enough) noexcept {
    double last = kUnbounded;
    double least = kUnbounded;
    int idle = 0;
    for (int i = 0; i < most && solves_ < most_; ++i) {
      const Vec3 from = x_;
      if (!step(c)) return false;
      const Vec3 d = x_ - from;
      read(c);
      double now = missing();
      if (i > 0 && !(now <= 0.9 * last)) {
        if (shorten(c, from, d) || halve(c, from, d, last)) {
          believePlace();
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

  /// From the last tick's pieces, turned with their planes and lines.
  bool fromLast() noexcept {
    const auto turned = [](const Vec3& q, const Vec3& b, bool sticks) {
      const Vec3 v = across(q, b);
      const double length = v.norm();
      return sticks || !(length > 0.0) ? v : Vec3(v / length);
    };
    x_ = memory_.motion;
    for (RoughPlane& p : planes()) p.pull = turned(p.q, p.pull, p.sticks);
    for (Pull& p : pulls()) {
      if (p.line) p.pull = turned(p.q, p.pull, p.holds);
    }
    return newton(hard_, kMostWarm, kPatience, enough_);
  }

  /// From kinks so soft that all is one smooth equation to hard ones.
  bool fromSoft() noexcept {
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
    while (c > hard_ && 2 * solves_ < most_) {
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

  /// From the old proxy with all planes pressed and nothing slipping.
  bool fromSticking() noexcept {
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

  double stiffness_;
  Vec3 spring_;  ///< The spring's end with directed forces.
  NewtonStart& memory_;
  double strengths_ = 0.0;  ///< The sum of strengths, S [N].
  double length_ = 0.0;     ///< S/k [m].
  double hard_ = 0.0;       ///< The compliance wanted [m].
  double enough_ = 0.0;
  bool known_ = false;
  Vec3 x_ = Vec3::Zero();
  Vec3 best_ = Vec3::Zero();
  double least_ = kUnbounded;
  int most_;  ///< Most solves.
  int solves_ = 0;
};

/// What each primitive does to the proxy [N]; directed forces are not among them.
void writeForces(const Compliant& found, std::span<Vec3> forces) noexcept {
  for (const RoughPlane& p : found.planes()) {
    forces[p.plane] = p.load * p.q;
    if (p.line != p.plane) forces[p.line] = -Compliant::frictionOf(p) * p.pull;
  }
  for (const Pull& p : found.pulls()) forces[p.index] = -p.strength * p.pull;
}

/// What the balance of the compliant kinks says to solveProxy.
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

SolveResult solveByNewton(const Vec3& probe, double stiffness, PrimitiveSet& set, const Vec3& proxy,
                          const SolverParams& params, WarmStart& warm, NewtonStart& start,
                          std::span<Vec3> forces) noexcept {
  const auto links = set.links();
  const auto items = set.items();
  for (const FrictionLink& link : links) set.setStrength(link, 0.0);
  // Bad input is told by solveProxy; what follows takes it as good.
  const bool good = proxy.allFinite() && probe.allFinite() && stiffness > 0.0;
  if (!good || links.empty()) {
    start.forget();
    return solveProxy(probe, stiffness, items, proxy, params, &warm, forces);
  }
  Compliant search(probe, stiffness, set, proxy, params.max_iterations, start);
  const bool found = search.solve();
  if (found) {
    search.harden();
  } else {
    search.goToBest();
  }
  const bool remembered = start.count == links.size();
  for (const RoughPlane& p : search.planes()) {
    if (p.line == p.plane) continue;
    const std::size_t at = static_cast<std::size_t>(
        std::lower_bound(links.begin(), links.end(), p.plane,
                         [](const FrictionLink& a, std::size_t plane) { return a.plane < plane; }) -
        links.begin());
    const double most = p.coefficient * p.strength;
    const double last = remembered ? std::min(start.held[at], most) : 0.0;
    const double wanted = Compliant::frictionOf(p);
    set.setStrength(links[at], found ? wanted : std::max(wanted, last));
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
    start.plane_count = 0;  // the next balance starts cold
  } else if (const Vec3 x = result.proxy - proxy; search.loadsAt(x)) {
    writeForces(search, forces);
    result.error_bound += search.leftOver(x) / stiffness;
  }
  for (const FrictionLink& link : links) {
    const double load = items[link.plane].direction.dot(forces[link.plane]);
    const double strength = items[link.line].strength;
    const double missed = std::abs(link.coefficient * load - strength);
    result.error_bound += missed / stiffness;
    if (missed > 1e-4 + 1e-3 * strength) result.status = SolveStatus::kIterationLimit;
  }
  return result;
}

}  // namespace palpate::methods
