/// How a stream is traced: RK4 with two estimates of its error, one cell of the grid at a time. A
/// trilinear field has kinks at the faces of its cells, over which every method is of second order;
/// a step that is cut at the face keeps the fourth.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "palpate/engine/trace.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Traces through a `Flow`, which knows cells:
///
///     bool enter(const Vec3& u, const Vec3& direction)  the cell that holds u, on a face the one
///         that the direction leads into; false where there is no data
///     bool pass(int axis, int side)     on to the neighbour: side +1 or -1
///     Vec3 lower()                      the cell is [lower, lower + 1] in u, or
///     constexpr bool kCells             false: one smooth piece without faces
///     Vec3 value(const Vec3& u)         v by the cell's own polynomial, a little outside as well
///     Vec3 rate(const Vec3& v)          du / ds of a unit vector of W, s in voxels
///
/// u, the direction of `enter` and the result's position are in the cells' own coordinates, the
/// result's direction in W; `length`, order.length and order.hand are in voxels. Where v has no
/// direction the trace ends.
template <class Flow>
class CellTrace {
 public:
  /// Begins at `start`, in the cells' own coordinates; `flow` and `order` must outlive it. The step
  /// to try first is order.stride, but 0.05 to 1 voxel.
  CellTrace(Flow& flow, const Vec3& start, const TraceOrder& order) noexcept
      : flow_(flow),
        order_(order),
        sense_(order.length < 0.0 ? -1.0 : 1.0),
        u_(start),
        way_(sense_ * order.along),
        left_(std::abs(order.length)),
        wanted_(left_),
        stride_(std::clamp(order.stride, kLeast, kLongest)),
        towards_(way_.dot(order.hand) > 0.0) {}

  /// Goes on until the length is gone, the steps are used up, v has no direction or no data, or
  /// the place nearest to the hand, where it then ends, is passed too far. To be called once.
  [[nodiscard]] Trace run() noexcept {
    bool capped = false;
    if (flow_.enter(u_, flow_.rate(way_)) && direction(u_, way_, k1_)) {
      way_ = k1_;
      int steps = 0;
      const int most = 4 * order_.max_steps;  // steps that were too long included
      for (int tries = 0; left_ > kEnough; ++tries) {
        capped = steps >= order_.max_steps || tries >= most;
        if (capped) break;
        const Tried tried = tryStep();
        if (tried == Tried::kEnds || (tried == Tried::kMade && !goOn())) break;
        steps += tried == Tried::kMade ? 1 : 0;
      }
    }
    return {u_,       sense_ * way_, sense_ * (wanted_ - left_), stride_, samples_, capped,
            hairpin_, shortened_};
  }

 private:
  static constexpr double kLeast = 0.05;      // shortest step [voxels]
  static constexpr double kLongest = 1.0;     // longest step [voxels]
  static constexpr double kPast = 1.03;       // factor on the length of a step to reach a face
  static constexpr double kMostGrowth = 4.0;  // growth of a step without error, before the clamps
  static constexpr double kRough =
      1.0 / 75.0;                           // share of the rougher estimate that counts: measured
  static constexpr double kEnough = 1e-12;  // [voxels] left at which a trace has arrived
  static constexpr double kPastNearest = 0.5;  // share of the length: less overshoot dies away
  static constexpr double kStuck = 1e-6;       // [voxels]: two faces nearer than that are one
  enum class Tried : std::uint8_t { kMade, kTooLong, kEnds };

  /// Writes v/|v| to `d`, turned to the side of `like`; false where v has no direction.
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

  /// Distance to the face ahead, on the parabola of the last bend [voxels].
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

  /// The stages of an RK4 step of length h_, and its end; false where v has no direction.
  [[nodiscard]] bool stages() noexcept {
    if (!direction(u_ + 0.5 * h_ * r1_, k1_, k2_)) return false;
    const Vec3 r2 = flow_.rate(k2_);
    if (!direction(u_ + 0.5 * h_ * r2, k1_, k3_)) return false;
    const Vec3 r3 = flow_.rate(k3_);
    if (!direction(u_ + h_ * r3, k1_, k4_)) return false;
    const Vec3 r4 = flow_.rate(k4_);
    end_ = u_ + (h_ / 6.0) * (r1_ + 2.0 * r2 + 2.0 * r3 + r4);
    chord_ = (h_ / 6.0) * (k1_ + 2.0 * k2_ + 2.0 * k3_ + k4_);
    return direction(end_, k1_, k5_);
  }

  /// Tries a step to the trace's end, as far as the error estimates allow, or to the face ahead.
  [[nodiscard]] Tried tryStep() noexcept {
    h_ = std::min(left_, stride_);
    bool to_face = false;
    r1_ = flow_.rate(k1_);
    if constexpr (Flow::kCells) {
      const double reach = kPast * toFace() + 0.01;
      to_face = reach < h_;
      h_ = std::min(h_, reach);
    }
    if (!stages()) {
      // A place without a direction is near.
      if (h_ <= kLeast) return Tried::kEnds;
      stride_ = std::max(0.5 * std::min(h_, stride_), kLeast);
      return Tried::kTooLong;
    }
    // One estimate is the derivative at the end, of fourth order in h, which now and then vanishes
    // where the error does not; the other the trapezoidal rule less the midpoint rule, of third.
    const double error = h_ / 6.0 * (k4_ - k5_).norm();
    const double rough = kRough * h_ / 2.0 * (k1_ - k2_ - k3_ + k4_).norm();
    double grow = kMostGrowth;
    if (error > 0.0) grow = 0.9 * std::sqrt(std::sqrt(order_.tolerance / error));
    if (rough > 0.0) grow = std::min(grow, 0.9 * std::cbrt(order_.tolerance / rough));
    if (std::max(error, rough) > order_.tolerance && h_ > 1.2 * kLeast) {
      stride_ = std::clamp(h_ * std::clamp(grow, 0.3, 0.9), kLeast, kLongest);
      return Tried::kTooLong;
    }
    // A step cut short by a face tells of longer steps only that they may be as long as before.
    const double next = h_ * std::clamp(grow, 0.5, 2.0);
    const bool cut = to_face || h_ >= left_;
    stride_ = std::clamp(cut && grow >= 1.0 ? std::max(stride_, next) : next, kLeast, kLongest);
    return Tried::kMade;
  }

  /// Goes where the step led, or to the face that it passes; false where the trace ends there.
  [[nodiscard]] bool goOn() noexcept {
    if (overshoots()) return true;
    const Vec3 r5 = flow_.rate(k5_);
    // |hand - x(s)|^2 / 2 has the second derivative 1 - (hand - x).x''.
    if ((k5_ - k1_).dot(order_.hand - gone_ - 0.5 * chord_) > h_) hairpin_ = true;
    bend_ = (r5 - r1_) / h_;
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

  /// On the outer side of a bend a length that was taken from the tangent leads past the place that
  /// is nearest to the hand, by kappa d of it: beyond 1 the proxy would go to and fro for ever.
  /// Where the trace leads farther past that place than kPastNearest it goes back and ends there.
  /// Returns true where it does.
  [[nodiscard]] bool overshoots() noexcept {
    if (shortened_) return false;
    const double before = k1_.dot(order_.hand - gone_);
    const double after = k5_.dot(order_.hand - gone_ - chord_);
    if ((towards_ || before > 0.0) && after < 0.0) {
      // Directions without a sign turn at a face as well: there the step begins beyond the place.
      const double ahead = before > 0.0 ? before / (before - after) * h_ : 0.0;
      nearest_ = {true, hairpin_, u_, k1_, gone_, wanted_ - left_, ahead};
    }
    towards_ = after > 0.0;
    if (!nearest_.passed || !(after < -kPastNearest * std::abs(order_.length))) return false;
    shortened_ = true;
    hairpin_ = nearest_.hairpin;
    u_ = nearest_.u;
    k1_ = way_ = nearest_.way;
    gone_ = nearest_.gone;
    left_ = nearest_.ahead;
    wanted_ = nearest_.length + left_;
    last_ = {};
    if (!flow_.enter(u_, flow_.rate(k1_))) left_ = 0.0;  // the cell was entered before
    return true;
  }

  /// Where the step leaves its cell.
  struct Face {
    int axis = -1;  ///< Axis of the face; -1: the step stays in its cell.
    int side = 0;
    double share = 2.0;  ///< Share of the step at which it leaves.
  };

  /// Coordinate `a` at share t of the step, on the cubic through both of its ends, in u.
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
    gone_ += face.share * chord_;
    way_ = k1_ + face.share * (k5_ - k1_);
    // Directions without a sign may point into a face from both sides: there the stream ends.
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
  double wanted_;  ///< Length ordered, in all [voxels].
  double stride_;
  int samples_ = 0;
  bool hairpin_ = false;
  bool shortened_ = false;
  /// Where the last step that passed a place nearest to the hand began.
  struct Nearest {
    bool passed = false;
    bool hairpin = false;
    Vec3 u = Vec3::Zero();
    Vec3 way = Vec3::Zero();
    Vec3 gone = Vec3::Zero();
    double length = 0.0;  ///< Arc length from the trace's start to the step's [voxels].
    double ahead = 0.0;   ///< Arc length from the step's start to the place [voxels].
  };
  bool towards_;  ///< The last step still came nearer to the hand at its end.
  Nearest nearest_;
  Vec3 gone_ = Vec3::Zero();  ///< Displacement from the trace's start, in W [voxels].
  Vec3 bend_ = Vec3::Zero();  ///< The derivative of du/ds over the last step.
  Face last_;                 ///< The face that was crossed last.
  // The step that is tried: k are directions in W, r the same in u.
  double h_ = 0.0;
  Vec3 k1_, k2_, k3_, k4_, k5_, r1_;
  Vec3 end_, chord_;  ///< The step's end in u; its chord in W.
};

/// The trace of a CellTrace from `start`, in the cells' own coordinates. RT: no allocation, if the
/// flow makes none. Cost: four values of v a step, five where it crosses a face; rejected
/// steps count.
template <class Flow>
[[nodiscard]] Trace traceCells(Flow& flow, const Vec3& start, const TraceOrder& order) noexcept {
  return CellTrace<Flow>(flow, start, order).run();
}

}  // namespace palpate
