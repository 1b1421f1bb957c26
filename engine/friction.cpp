#include "palpate/engine/friction.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>

namespace palpate {
namespace {

constexpr double kCompliance = 1e-6;  // c [m]
constexpr double kEnough = 1e-10;     // |R| of a solution, as a share of the sum of strengths
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
            int most, FrictionStart& memory) noexcept
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

  /// Finds loads and frictions, without compliance; false where no way led to them.
  bool solve() noexcept {
    if (known_ && fromLast() && harden()) return true;
    dropKept();
    return (fromSoft(most_ / 2) || fromSticking()) && harden();
  }

  /// The loads by which kinks about x, less than c apart, share what balances the spring there. The
  /// place at which they are read gives way for the spring, whose end is so far off that it pulls
  /// the same everywhere. False where none are found: then loads mean nothing.
  bool loadsAt(const Vec3& x) noexcept {
    constexpr double kGivesWay = 1e-3;  // share of the stiffness that stays
    spring_ = x + (spring_ - x) / kGivesWay;
    stiffness_ *= kGivesWay;
    return newton(hard_, kMostHard, kMostHard, enough_);
  }

  /// Begins at x, with nothing kept.
  void beginAt(const Vec3& x) noexcept { goTo(x, hard_); }

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
  static constexpr double kLess = 0.9;        // of |R|, that a step has to leave
  static constexpr double kThere = 1e-8;      // of S/k, or less, that the place still moves
  static constexpr double kLeastKept = 1e-2;  // of the compliance, while loads are kept

  /// |R| of a solution at c, as a share of S: loads are rounded the more the less c.
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

  /// How far the place is from where it is held, with what is kept, and its length, c at least.
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
    Vec3 part = 0.5 * d;
    for (int i = 0; i < 6; ++i, part *= 0.5) {
      x_ = from + part;
      read(c);
      if (missing() <= kLess * start) return true;
    }
    return false;
  }

  /// Beyond a fold: a balance has ended, J's determinant has turned its sign, and Newton leads back
  /// to where |R| is least and not zero. Onwards, against its step, the determinant turns again,
  /// and another balance begins (Branin 1972). False where it does not.
  bool leap(double c, const Vec3& from, const Vec3& d) noexcept {
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

  /// Newton at c until |R| <= enough S. The first step is with the pieces as they are: the last
  /// tick's, or those of the last c. False after `most` steps, or `patience` that do not halve |R|.
  bool newton(double c, int most, int patience, double enough) noexcept {
    double last = kUnbounded;
    double least = kUnbounded;
    int idle = 0;
    bool leapt = false;
    for (int i = 0; i < most && solves_ < most_; ++i) {
      const Vec3 from = x_;
      if (!step(c)) return false;
      const Vec3 d = x_ - from;
      read(c);
      double now = missing();
      if (i > 0 && !(now <= kLess * last)) {
        const bool nearer = shorten(c, from, d) || halve(c, from, d, last);
        if (nearer || (turned_ && leap(c, from, d))) {
          believePlace();
          if (!nearer && !leapt) {
            leapt = true;
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

  /// From the last tick's pieces and what they kept, turned with their planes and lines: a balance
  /// that stays takes a step.
  bool fromLast() noexcept {
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

  /// From kinks so soft that all is one smooth equation to hard ones.
  bool fromSoft(int until) noexcept {
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

  /// Takes the compliance out, by the method of multipliers: what a kink bears it keeps, and the
  /// place goes onto the kinks, the faster the less c. A friction keeps its pull where it slips,
  /// too: a proxy that comes to rest is at its threshold, and would take turns. Where that does not
  /// come to an end, as frictions that press each other's planes may not let it, c alone shrinks.
  /// False where the place was found by what the last tick had kept, and none is near it without.
  bool harden() noexcept {
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
  Vec3 spring_;  ///< The spring's end with directed forces.
  FrictionStart& memory_;
  double strengths_ = 0.0;  ///< The sum of strengths, S [N].
  double length_ = 0.0;     ///< S/k [m].
  double hard_ = 0.0;       ///< The compliance wanted [m].
  double enough_ = 0.0;
  bool turned_ = false;    ///< The determinant of the last step was below zero.
  double rounding_ = 0.0;  ///< |R| that rounding leaves at hard_, as a share of S
  bool known_ = false;
  Vec3 x_ = Vec3::Zero();
  Vec3 best_ = Vec3::Zero();
  double least_ = kUnbounded;
  int most_;  ///< Most solves.
  int solves_ = 0;
};

/// One plane, the friction on it, and drags: points where that friction grips, the old proxy. All
/// is in metres, forces divided by k. N is how far the spring's end is behind the plane, T how far
/// along it from the grip, r the distance from the grip, u that along the plane.
///
/// A plane that bears N and all drags as well has the proxy on it. Where it has moved in front of
/// the grip, by micrometres, drags would press on it, friction slip at two loads, and the balance
/// have two answers or three. There the proxy is dragged along the plane only, from the grip's
/// foot:
///
///     n = max(0, N),   friction min(T, mu n),   drags the rest, s_d at most.
///
/// In front of its plane a grip holds where it is; on the plane
///
///     u + mu n + s_d u/r = T,   n = N - s_d h/r,   h the grip's height,
///
/// whose left side grows with u. Without drags the first line holds for any height, with n <= s.
class OnePlane {
 public:
  OnePlane(const Vec3& probe, double stiffness, const PrimitiveSet& set) noexcept
      : stiffness_(stiffness),
        link_(set.links()[0]),
        plane_(set.items()[link_.plane]),
        grip_(set.items()[link_.line].position),
        from_(grip_ - probe),
        q_(plane_.direction.normalized()),
        height_(q_.dot(grip_ - plane_.position)),
        most_(plane_.strength / stiffness) {
    spring_ = -from_;
    for (const Primitive& p : set.items()) {
      const double strength = p.strength / stiffness;
      size_ += strength;
      if (p.kind == PrimitiveKind::kForce) spring_ += strength * p.direction.normalized();
      if (p.kind == PrimitiveKind::kPoint) drags_ += strength;
    }
  }

  /// True where a set is such a plane, its friction and drags.
  [[nodiscard]] static bool fits(const PrimitiveSet& set) noexcept {
    if (set.links().size() != 1) return false;
    const FrictionLink& link = set.links()[0];
    const auto items = set.items();
    const auto among = [&](const Primitive& p) {
      switch (p.kind) {
        case PrimitiveKind::kForce:
          return true;
        case PrimitiveKind::kPoint:
          return p.position == items[link.line].position || p.strength == 0.0;
        case PrimitiveKind::kLine:
          return &p == &items[link.line] || p.strength == 0.0;
        case PrimitiveKind::kPlane:
          return &p == &items[link.plane] || p.strength == 0.0;
      }
      return false;
    };
    return std::all_of(items.begin(), items.end(),
                       [&](const auto& p) { return isValid(p) && among(p); });
  }

  /// Finds the balance; false where the plane might give way to drags.
  bool solve() noexcept {
    const double into = -(q_.dot(spring_) + height_);
    if (height_ > 0.0) {
      moved_ = pulled(spring_);
      if (q_.dot(moved_) + height_ >= 0.0) {
        share(spring_ - moved_);
        return true;
      }
      if (drags_ > 0.0) return into <= most_ && solveInFront(into);
    }
    if (drags_ > 0.0 && std::max(into, 0.0) + drags_ > most_) return false;
    foot_ = -height_ * q_;
    load_ = std::clamp(into, 0.0, most_);
    const Vec3 left = spring_ - foot_;
    along_ = across(q_, left);
    const double way = along_.norm();
    const double grips = std::min(way, link_.coefficient * load_);
    if (way > 0.0) friction_ = (grips / way) * along_;
    const Vec3 rest = left + load_ * q_ - friction_;
    moved_ = foot_ + pulled(rest);
    share(rest - (moved_ - foot_));
    return true;
  }

  /// The answer, of which `forces` are as solveProxy fills them; what holds is left in the set.
  SolveResult tell(const Vec3& probe, PrimitiveSet& set, std::span<Vec3> forces) const noexcept {
    SolveResult result;
    result.offset = from_ + moved_;
    result.proxy = probe + result.offset;
    // Rounding: of positions, from the probe, from the plane and where drags are put; of sums.
    const double reach = from_.lpNorm<Eigen::Infinity>() +
                         (grip_ - plane_.position).lpNorm<Eigen::Infinity>() + size_ +
                         (foot_.isZero(0.0) ? 0.0 : grip_.lpNorm<Eigen::Infinity>());
    result.error_bound = 8.0 * std::numeric_limits<double>::epsilon() * reach;
    result.iterations = solves_;
    if (solves_ > 0) result.solver = SolverKind::kPair;
    for (std::size_t i = 0; i < set.size(); ++i) {
      const Primitive& p = set.items()[i];
      forces[i].setZero();
      if (p.kind == PrimitiveKind::kForce) forces[i] = p.strength * p.direction.normalized();
      if (p.kind != PrimitiveKind::kPoint || p.strength == 0.0) continue;
      forces[i] = -p.strength * dragged_;
      set.setPosition(i, grip_ + foot_);
    }
    forces[link_.plane] = stiffness_ * load_ * q_;
    forces[link_.line] = -stiffness_ * friction_;
    set.setStrength(link_, link_.coefficient * load_ * stiffness_);
    set.setPosition(link_.line, grip_ + foot_);
    return result;
  }

 private:
  /// How far a pull takes a proxy that drags hold.
  [[nodiscard]] Vec3 pulled(const Vec3& pull) const noexcept {
    const double length = pull.norm();
    return length > drags_ ? Vec3((1.0 - drags_ / length) * pull) : Vec3(Vec3::Zero());
  }

  /// What drags bear, `pull`, if friction holds all it can. Where the proxy has not moved the two
  /// share it in proportion to their strengths.
  void share(Vec3 pull) noexcept {
    if (!(drags_ > 0.0)) return;
    const double sliding = link_.coefficient * load_;
    const double way = along_.norm();
    if (moved_ == foot_ && sliding > 0.0 && way > 0.0) {
      const double pressing = pull.dot(q_);
      const double room = std::sqrt(std::max(0.0, drags_ * drags_ - pressing * pressing));
      const double held = std::max(way - room, way * sliding / (sliding + drags_));
      pull += friction_;
      friction_ = (held / way) * along_;
      pull -= friction_;
    }
    dragged_ = pull / drags_;
  }

  /// The proxy on a plane behind its grip, by Newton between bounds.
  bool solveInFront(double into) noexcept {
    constexpr int kMost = 60;
    const double mu = link_.coefficient;
    along_ = across(q_, spring_);
    const double way = along_.norm();
    double low = std::max(0.0, way - mu * into - drags_);
    double high = way;
    double u = low;
    double r = std::max(height_, std::hypot(u, height_));
    if (mu * (into - drags_) < way) {
      while (solves_ < kMost) {
        ++solves_;
        const double left = u + mu * (into - drags_ * height_ / r) + drags_ * u / r - way;
        (left > 0.0 ? high : low) = u;
        const double slope = 1.0 + drags_ * height_ * (height_ + mu * u) / (r * r * r);
        double next = u - left / slope;
        if (!(next >= low && next <= high)) next = 0.5 * (low + high);
        // As near as rounding of the left side lets it, and as the direction from the grip needs.
        const double least = std::numeric_limits<double>::epsilon() * (r + way / slope);
        const bool there = std::abs(next - u) <= 4.0 * least;
        u = next;
        r = std::hypot(u, height_);
        if (there) break;
      }
    } else {
      u = 0.0;
      r = height_;
    }
    load_ = std::max(0.0, into - drags_ * height_ / r);
    if (way > 0.0) friction_ = (std::min(way, mu * load_) / way) * along_;
    moved_ = (way > 0.0 ? Vec3((u / way) * along_) : Vec3(Vec3::Zero())) - height_ * q_;
    dragged_ = moved_ / r;
    return true;
  }

  double stiffness_;
  const FrictionLink& link_;
  const Primitive& plane_;
  Vec3 grip_;
  Vec3 from_;  ///< From the probe to the grip.
  Vec3 q_;
  double height_;  ///< Of the grip.
  double most_;    ///< The plane's strength.
  double drags_ = 0.0;
  double size_ = 0.0;  ///< All strengths.
  Vec3 spring_;        ///< Its end with directed forces, from the grip, as all that follow.
  Vec3 foot_ = Vec3::Zero();
  Vec3 along_ = Vec3::Zero();
  Vec3 friction_ = Vec3::Zero();
  Vec3 dragged_ = Vec3::Zero();
  Vec3 moved_ = Vec3::Zero();
  double load_ = 0.0;
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

/// True where more directions are held at x than there are: the load can be shared in many ways.
bool overdetermined(std::span<const Primitive> primitives, const Vec3& x) noexcept {
  constexpr double kHere = 1e-9;  // [m]
  constexpr double kSome = 1e-6;  // an eigenvalue of the projectors' sum that counts
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
        held += acrossOf(p.direction);
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

/// Without friction: of the loads that balance those of the least sum |f|^2/s.
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

SolveResult solveWithFriction(const Vec3& probe, double stiffness, PrimitiveSet& set,
                              const Vec3& proxy, const SolverParams& params, WarmStart& warm,
                              FrictionStart& start, std::span<Vec3> forces) noexcept {
  const auto links = set.links();
  const auto items = set.items();
  if (links.empty()) {
    return solveSmooth(probe, stiffness, set, proxy, params, warm, start, forces);
  }
  for (const FrictionLink& link : links) set.setStrength(link, 0.0);
  // Bad input is told by solveProxy; what follows takes it as good.
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
    start.plane_count = 0;  // the next balance starts cold
  } else {
    // The answer is what the loads balance: it meets the law, and is as near to the balance with
    // its strengths as the bound says.
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
