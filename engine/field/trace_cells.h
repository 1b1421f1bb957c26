/// Traces a stream cell by cell, by RK4 with two error estimates. A trilinear field has kinks at
/// the faces of its cells, and a step over a kink is of second order only. A step that ends at the
/// face keeps the fourth order. If at most 0.1 voxel is left, the trace uses the midpoint rule
/// where that rule is accurate enough.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "palpate/engine/field/trace.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Traces a stream through a `Flow`, which provides the cells:
///
///     bool enter(const Vec3& u, const Vec3& direction)  enters the cell that contains u; on a
///         face, the cell ahead in `direction`; returns false without data
///     bool pass(int axis, int side)     enters the neighbour: side +1 or -1
///     Vec3 lower()                      the cell is [lower, lower + 1] in u, or
///     constexpr bool kCells             false: a smooth field without faces
///     Vec3 value(const Vec3& u)         v by the polynomial of the cell, also slightly outside
///     Vec3 rate(const Vec3& v)          du / ds of a unit vector of W, s in voxels
///
/// u, the `direction` of `enter` and the resulting position are in cell coordinates. The resulting
/// direction is in W. `length`, order.length and order.hand are in voxels. The trace ends where v
/// has no direction.
///
/// A trace to the hand descends from its start to a minimum of E(s) = d.Md / 2, with d = hand -
/// x(s) and M = order.metric:
///
///     g = -E' = x'.Md,   -g' = E'' = x'.Mx' - x''.Md,   Newton's step g / max(E'', 0.1 x'.Mx')
///
/// E'' <= 0 beyond the centre of curvature. There the trace continues, because the distance falls
/// while g > 0. The trace ends at the first root of g. If a step passes the root, the trace
/// shortens the step to the root of g on the cubic through its ends.
template <class Flow>
class CellTrace {
 public:
  /// Begins at `start`, in cell coordinates. `flow` and `order` must outlive the object. The first
  /// step to try is at most order.stride, limited to 0.05 to 1 voxel.
  CellTrace(Flow& flow, const Vec3& start, const TraceOrder& order) noexcept
      : flow_(flow),
        order_(order),
        sense_(order.length < 0.0 ? -1.0 : 1.0),
        u_(start),
        way_(sense_ * order.along),
        left_(std::abs(order.length)),
        wanted_(left_),
        stride_(std::clamp(order.stride, kLeast, kLongest)),
        turn_(order.bend) {}

  /// Traces until the requested length or the place nearest to the hand. The trace ends earlier if
  /// the steps are used up, or where v has no direction or no data. Call this function once.
  [[nodiscard]] Trace run() noexcept {
    bool capped = false;
    if (begin()) {
      way_ = k1_;
      int steps = 0;
      // limit of all tried steps, including those that were too long
      const int most = 4 * order_.max_steps;
      for (int tries = 0; left_ > kEnough; ++tries) {
        if (order_.to_hand && atHand()) break;
        capped = steps >= order_.max_steps || tries >= most;
        if (capped) break;
        const Tried tried = tryStep();
        if (tried == Tried::kEnds || (tried == Tried::kMade && !goOn())) break;
        steps += tried == Tried::kMade ? 1 : 0;
      }
    }
    const bool arrived = order_.to_hand && atHand();
    return {u_,      sense_ * way_, sense_ * (wanted_ - left_), stride_, samples_, capped, hairpin_,
            arrived, turn_};
  }

 private:
  static constexpr double kLeast = 0.05;   // [voxels]: shortest stride
  static constexpr double kLongest = 1.0;  // [voxels]: longest stride
  // a step to a face is longer by this factor, so that it crosses the face
  static constexpr double kPast = 1.03;
  // growth of the stride after a step without error, before its limits in tryStep()
  static constexpr double kMostGrowth = 4.0;
  static constexpr double kRough =
      1.0 / 75.0;  // weight of the rough error estimate, by measurement
  // [voxels]: the trace is complete if less length is left
  static constexpr double kEnough = 1e-12;
  // [voxels]: longest correction towards the hand that uses only the known bend
  static constexpr double kNudge = 0.02;
  static constexpr double kShort = 0.1;  // [voxels]: longest midpoint step
  // largest error of a midpoint step, divided by tolerance * h_
  static constexpr double kShare = 0.35;
  static constexpr double kSteepest = 0.1;  // least E'' of Newton's step, as a share of x'.Mx'
  // [voxels]: a trace ends if it crosses a face back within this length
  static constexpr double kStuck = 1e-6;
  enum class Tried : std::uint8_t { kMade, kTooLong, kEnds };

  /// Enters the first cell in the direction of the trace. Returns false if there are no data or v
  /// has no direction.
  [[nodiscard]] bool begin() noexcept {
    const Vec3 pull = order_.metric * order_.hand;
    if (order_.to_hand && way_.dot(pull) < 0.0) turnRound();
    if (!flow_.enter(u_, flow_.rate(way_)) || !direction(u_, way_, k1_)) return false;
    if (!order_.to_hand || !(k1_.dot(pull) < 0.0)) return true;
    way_ = k1_;
    turnRound();
    return flow_.enter(u_, flow_.rate(way_)) && direction(u_, way_, k1_);
  }

  void turnRound() noexcept {
    sense_ = -sense_;
    way_ = -way_;
  }

  /// Writes v/|v| to `d`, negated if it points against `like`. Returns false if v has no direction.
  bool direction(const Vec3& u, const Vec3& like, Vec3& d) noexcept {
    ++samples_;
    const Vec3 v = flow_.value(u);
    const double length = std::sqrt(v.x() * v.x() + v.y() * v.y() + v.z() * v.z());
    if (!(length > 1e-300) || !std::isfinite(length)) return false;
    const double sign = v.x() * like.x() + v.y() * like.y() + v.z() * like.z() < 0.0 ? -1.0 : 1.0;
    const double f = sign / length;
    d = Vec3(f * v.x(), f * v.y(), f * v.z());
    return true;
  }

  /// Returns the distance to the face ahead [voxels], on the parabola with the last bend.
  [[nodiscard]] double toFace() const noexcept {
    double face = 1e9;
    for (int a = 0; a < 3; ++a) {
      const double t = u_[a] - flow_.lower()[a];
      for (const double side : {-1.0, 1.0}) {
        const double gap = std::max(side > 0.0 ? 1.0 - t : t, 0.0);
        const double speed = side * r1_[a];
        const double turn = 0.5 * side * bend_[a];
        const double root = speed * speed + 4.0 * turn * gap;
        if (root < 0.0) continue;
        const double sum = speed + std::sqrt(root);
        if (sum > 1e-12) face = std::min(face, 2.0 * gap / sum);
      }
    }
    return face;
  }

  /// Reads the direction k2_ in the middle of a straight step of length h_.
  [[nodiscard]] bool middle() noexcept {
    if (h_ == middle_of_) return true;
    middle_of_ = 0.0;
    if (!direction(u_ + 0.5 * h_ * r1_, k1_, k2_)) return false;
    middle_of_ = h_;
    return true;
  }

  /// Makes a step of length h_ by the midpoint rule, with one value of v instead of four. The error
  /// is estimated as h^3 x''' / 6. The change of the bend since the last step, divided by h_,
  /// estimates x'''. The estimate can be too low if the last step was shorter. Returns false and
  /// makes no step if the error is too large, the step leaves its cell, or v has no direction.
  [[nodiscard]] bool shortStep() noexcept {
    if (!middle()) return false;
    const Vec3 change = 2.0 * (k2_ - k1_);
    const double error = h_ / 6.0 * (change - h_ * turn_).norm();
    if (!(error <= kShare * order_.tolerance * h_)) return false;
    end_ = u_ + h_ * flow_.rate(k2_);
    if constexpr (Flow::kCells) {
      const Vec3 t = end_ - flow_.lower();
      if (!(t.minCoeff() >= 0.0 && t.maxCoeff() <= 1.0)) return false;
    }
    chord_ = h_ * k2_;
    k5_ = (k1_ + change).normalized();
    return true;
  }

  /// Computes the stages and the end of an RK4 step. Returns false if v has no direction there.
  [[nodiscard]] bool stages() noexcept {
    if (!middle()) return false;
    const Vec3 r2 = flow_.rate(k2_);
    if (!direction(u_ + 0.5 * h_ * r2, k1_, k3_)) return false;
    const Vec3 r3 = flow_.rate(k3_);
    if (!direction(u_ + h_ * r3, k1_, k4_)) return false;
    const Vec3 r4 = flow_.rate(k4_);
    end_ = u_ + (h_ / 6.0) * (r1_ + 2.0 * r2 + 2.0 * r3 + r4);
    chord_ = (h_ / 6.0) * (k1_ + 2.0 * k2_ + 2.0 * k3_ + k4_);
    return direction(end_, k1_, k5_);
  }

  /// Tries a step to the trace's end or to the face ahead, as far as the error estimates allow.
  [[nodiscard]] Tried tryStep() noexcept {
    const double wanted = order_.to_hand ? std::min(left_, aim_) : left_;
    h_ = std::min(wanted, stride_);
    bool to_face = false;
    r1_ = flow_.rate(k1_);
    middle_of_ = 0.0;
    // Longer traces use RK4, because only RK4 adapts stride_.
    if (wanted <= kShort && shortStep())
      return !order_.to_hand || backToHand() ? Tried::kMade : Tried::kEnds;
    if constexpr (Flow::kCells) {
      const double reach = kPast * toFace() + 0.01;
      to_face = reach < h_;
      h_ = std::min(h_, reach);
    }
    if (!stages()) {
      // A point at which v has no direction is near.
      if (h_ <= kLeast) return Tried::kEnds;
      stride_ = std::max(0.5 * std::min(h_, stride_), kLeast);
      return Tried::kTooLong;
    }
    // The first estimate is of fourth order in h, but can vanish where the error does not. The
    // second, the difference between the trapezoidal and midpoint rules, is of third order.
    const double error = h_ / 6.0 * (k4_ - k5_).norm();
    const double rough = kRough * h_ / 2.0 * (k1_ - k2_ - k3_ + k4_).norm();
    double grow = kMostGrowth;
    if (error > 0.0) grow = 0.9 * std::sqrt(std::sqrt(order_.tolerance / error));
    if (rough > 0.0) grow = std::min(grow, 0.9 * std::cbrt(order_.tolerance / rough));
    if (std::max(error, rough) > order_.tolerance && h_ > 1.2 * kLeast) {
      stride_ = std::clamp(h_ * std::clamp(grow, 0.3, 0.9), kLeast, kLongest);
      return Tried::kTooLong;
    }
    // If a face has cut the step short and the error is small, the stride does not shrink.
    const double next = h_ * std::clamp(grow, 0.5, 2.0);
    const bool cut = to_face || h_ >= wanted;
    stride_ = std::clamp(cut && grow >= 1.0 ? std::max(stride_, next) : next, kLeast, kLongest);
    return !order_.to_hand || backToHand() ? Tried::kMade : Tried::kEnds;
  }

  /// Moves to the end of the step, or to the first face. Returns false if the trace ends there.
  [[nodiscard]] bool goOn() noexcept {
    const Vec3 r5 = flow_.rate(k5_);
    // The condition means E'' < 0 in the middle of the step.
    const Vec3 pull = order_.metric * (order_.hand - gone_ - 0.5 * chord_);
    if ((k5_ - k1_).dot(pull) * h_ > chord_.dot(order_.metric * chord_)) hairpin_ = true;
    bend_ = (r5 - r1_) / h_;
    turn_ = (k5_ - k1_) / h_;
    if constexpr (Flow::kCells) {
      const Face face = faceAhead(r5);
      if (face.axis >= 0) return crossOver(face, r5);
    }
    gone_ += chord_;
    u_ = end_;
    k1_ = way_ = k5_;
    left_ -= h_;
    return true;
  }

  /// Returns g / max(E'', 0.1 x'.Mx') for x' = `way`, x'' = `turn` and Md = `pull`.
  [[nodiscard]] double newtonStep(double g, const Vec3& way, const Vec3& turn,
                                  const Vec3& pull) const noexcept {
    const double straight = way.dot(order_.metric * way);
    return g / std::max(straight - turn.dot(pull), kSteepest * straight);
  }

  /// Sets `aim_` to Newton's step to the point nearest to the hand. Returns true at that point.
  [[nodiscard]] bool atHand() noexcept {
    const Vec3 pull = order_.metric * (order_.hand - gone_);
    const double g = way_.dot(pull);
    aim_ = newtonStep(g, way_, turn_, pull);
    return g <= order_.near;
  }

  /// If the step passes the point nearest to the hand, or ends just before it, moves the end of the
  /// step to that point. Returns false if v has no direction there. Cost: usually up to five values
  /// of v, at most 16.
  [[nodiscard]] bool backToHand() noexcept {
    constexpr int kMost = 4;
    for (int i = 0; i < kMost; ++i) {
      const Vec3 pull = order_.metric * (order_.hand - gone_ - chord_);
      const double g = k5_.dot(pull);
      if (std::abs(g) <= order_.near) return true;
      const Vec3 turn = (k5_ - k1_) / h_;
      const double rest = newtonStep(g, k5_, turn, pull);
      if (std::abs(rest) <= kNudge && rest > -0.5 * h_) {
        // x(s + rest) = x + rest x' + rest^2 / 2 x'', to third order.
        const Vec3 way = rest * k5_ + 0.5 * rest * rest * turn;
        end_ += flow_.rate(way);
        chord_ += way;
        h_ += rest;
        if (!direction(end_, k5_, k5_)) return false;
        continue;
      }
      if (g > 0.0) return true;
      h_ *= shareToHand(g);
      if (!(h_ <= kShort && shortStep()) && !stages()) return false;
    }
    return true;
  }

  /// Returns the share of the step at which g = 0 on its cubic, by regula falsi (Illinois).
  [[nodiscard]] double shareToHand(double g_end) const noexcept {
    const Vec3 d = order_.hand - gone_;
    constexpr int kMost = 8;
    constexpr double kExact = 0.1;  // largest remaining |g|, divided by `near`
    double low = 0.0;
    double high = 1.0;
    double g_low = k1_.dot(order_.metric * d);
    double g_high = g_end;
    double t = 1.0;
    int moved = 0;  // bound that the last pass moved: -1 low, 1 high
    for (int i = 0; i < kMost; ++i) {
      t = (low * g_high - high * g_low) / (g_high - g_low);
      const double g = directionAt(t).dot(order_.metric * (d - goneAt(t)));
      if (std::abs(g) < kExact * order_.near) break;
      const int side = g > 0.0 ? -1 : 1;
      (side < 0 ? low : high) = t;
      (side < 0 ? g_low : g_high) = g;
      if (side == moved) (side < 0 ? g_high : g_low) *= 0.5;
      moved = side;
    }
    return t;
  }

  /// Returns the displacement in W at share t of the step, on the cubic through both ends.
  [[nodiscard]] Vec3 goneAt(double t) const noexcept {
    const double t2 = t * t;
    const double t3 = t2 * t;
    return (t3 - 2.0 * t2 + t) * h_ * k1_ + (3.0 * t2 - 2.0 * t3) * chord_ + (t3 - t2) * h_ * k5_;
  }

  /// Returns the unit direction at share t of the step, on the same cubic.
  [[nodiscard]] Vec3 directionAt(double t) const noexcept {
    const double t2 = t * t;
    return Vec3((3.0 * t2 - 4.0 * t + 1.0) * h_ * k1_ + 6.0 * (t - t2) * chord_ +
                (3.0 * t2 - 2.0 * t) * h_ * k5_)
        .normalized();
  }

  struct Face {
    int axis = -1;  ///< Axis of the face; -1: the step stays in its cell.
    int side = 0;
    double share = 2.0;  ///< Fraction of the step at which it crosses the face; 2 if it does not.
  };

  /// Returns coordinate `a` of u at share t of the step, on the same cubic.
  [[nodiscard]] double cubic(double t, int a, const Vec3& r5) const noexcept {
    const double t2 = t * t;
    const double t3 = t2 * t;
    return (2.0 * t3 - 3.0 * t2 + 1.0) * u_[a] + (t3 - 2.0 * t2 + t) * h_ * r1_[a] +
           (3.0 * t2 - 2.0 * t3) * end_[a] + (t3 - t2) * h_ * r5[a];
  }

  [[nodiscard]] double faceAt(int axis, int side) const noexcept {
    return flow_.lower()[axis] + (side > 0 ? 1.0 : 0.0);
  }

  [[nodiscard]] Face faceAhead(const Vec3& r5) const noexcept {
    Face first;
    for (int a = 0; a < 3; ++a) {
      for (const int s : {-1, 1}) {
        const double face = faceAt(a, s);
        if (!(s * (end_[a] - face) > 0.0)) continue;
        double low = 0.0;
        double high = 1.0;
        for (int i = 0; i < 40; ++i) {
          const double middle = 0.5 * (low + high);
          (s * (cubic(middle, a, r5) - face) > 0.0 ? high : low) = middle;
        }
        if (high < first.share) first = {a, s, high};
      }
    }
    return first;
  }

  [[nodiscard]] bool crossOver(const Face& face, const Vec3& r5) noexcept {
    Vec3 at(cubic(face.share, 0, r5), cubic(face.share, 1, r5), cubic(face.share, 2, r5));
    at[face.axis] = faceAt(face.axis, face.side);
    u_ = at;
    left_ -= face.share * h_;
    gone_ += goneAt(face.share);
    way_ = k1_ + face.share * (k5_ - k1_);
    // Directions without a sign may point into a face from both sides. The stream ends there.
    const bool back = face.axis == last_.axis && face.side == -last_.side;
    if (back && face.share * h_ < kStuck) {
      way_.normalize();
      return false;
    }
    last_ = face;
    if (!flow_.pass(face.axis, face.side) || !direction(u_, way_, k1_)) {
      way_.normalize();
      return false;
    }
    way_ = k1_;
    return true;
  }

  Flow& flow_;
  const TraceOrder& order_;
  double sense_;
  Vec3 u_;
  Vec3 way_;  ///< Unit direction in which the trace goes, in W.
  double left_;
  double wanted_;  ///< Requested length of the whole trace [voxels].
  double stride_;
  int samples_ = 0;
  bool hairpin_ = false;
  double aim_ = 0.0;  ///< Newton's step to the place nearest to the hand [voxels].
  Vec3 turn_;  ///< Second derivative of the curve from the last step (at first order.bend), in W
               ///< [1/voxel].
  Vec3 gone_ = Vec3::Zero();  ///< Displacement from the trace's start, in W [voxels].
  Vec3 bend_ = Vec3::Zero();  ///< The derivative of du/ds over the last step.
  Face last_;
  // The step under trial: k1_ to k5_ are directions in W, and r1_ is k1_ in u.
  double h_ = 0.0;
  double middle_of_ = 0.0;  ///< Step length for which k2_ was read.
  Vec3 k1_, k2_, k3_, k4_, k5_, r1_;
  Vec3 end_, chord_;  ///< The step's end in u; its chord in W.
};

/// Returns the trace of a CellTrace from `start`, in cell coordinates. RT: no allocation, if `flow`
/// allocates no memory. Cost: one or two values of v at the start, four or five for each tried
/// step, and one more if the step crosses a face. A midpoint step costs one value. On a trace to
/// the hand, a step that passes the nearest point costs up to 16 more.
template <class Flow>
[[nodiscard]] Trace traceCells(Flow& flow, const Vec3& start, const TraceOrder& order) noexcept {
  return CellTrace<Flow>(flow, start, order).run();
}

}  // namespace palpate
