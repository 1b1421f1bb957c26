/// Where a moving volume is: rigid poses between keyframes, and how it deforms besides.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/types.h"
#include "palpate/engine/warp.h"

namespace palpate {

/// A motion out of a volume's resting frame, the one that its field is given in, into W: a rigid
/// one, or, of a volume that deforms, what that is about a place.
struct Pose {
  Mat3 linear = Mat3::Identity();  ///< A rotation about W's origin where rigid, before `translate`.
  Mat3 back = Mat3::Identity();    ///< The inverse of `linear`.
  Vec3 translate = Vec3::Zero();   ///< [m]

  /// The rigid motion that turns and then shifts.
  [[nodiscard]] static Pose rigid(const Mat3& rotation, const Vec3& translate) noexcept {
    return {rotation, rotation.transpose(), translate};
  }
  /// Where a point of the resting frame is in W [m].
  [[nodiscard]] Vec3 operator()(const Vec3& p_rest) const noexcept {
    return linear * p_rest + translate;
  }
  /// The point of the resting frame that is at p in W [m].
  [[nodiscard]] Vec3 toRest(const Vec3& p) const noexcept { return back * (p - translate); }
  /// A vector of the matter, as a velocity or a fibre's direction, in W.
  [[nodiscard]] Vec3 vector(const Vec3& v_rest) const noexcept { return linear * v_rest; }
  /// A gradient, or the normal of a surface, in W.
  [[nodiscard]] Vec3 gradient(const Vec3& g_rest) const noexcept {
    return back.transpose() * g_rest;
  }
  /// The derivative of a gradient by the place, in W, where the pose is the same about it.
  [[nodiscard]] Mat3 gradientJacobian(const Mat3& of_rest) const noexcept {
    return back.transpose() * of_rest * back;
  }
  /// The derivative of a vector of the matter by the place, likewise.
  [[nodiscard]] Mat3 vectorJacobian(const Mat3& of_rest) const noexcept {
    return linear * of_rest * back;
  }
  /// True if all numbers are equal, without a tolerance.
  [[nodiscard]] bool operator==(const Pose& other) const noexcept {
    return linear == other.linear && translate == other.translate;
  }
};

/// A volume's pose at one time: the volume turns about W's origin, then shifts.
struct Keyframe {
  double time = 0.0;                                ///< Time since the scene began [s].
  std::array<double, 4> rotation_wxyz{1, 0, 0, 0};  ///< Normalised when used.
  Vec3 translate = Vec3::Zero();                    ///< [m]
};

/// How a volume moves: turned evenly the short way round and shifted evenly from keyframe to
/// keyframe, held before the first and after the last, or repeated. In the frame that moves so it
/// may deform. Const; shared by the volumes that move together.
class Motion {
 public:
  /// Throws SceneError, with `path` before what is wrong (/2/time), for no keyframe, times that do
  /// not ascend or are beyond 1e9 s, a shift of 1e6 m or more, a zero rotation, two in a row half
  /// a turn apart, or a repeated motion that has one keyframe or does not end where it began.
  explicit Motion(std::span<const Keyframe> keyframes, bool repeat = false,
                  const std::string& path = "/keyframes", WarpPtr warp = nullptr);
  /// Stands still and deforms.
  explicit Motion(WarpPtr warp);

  /// The pose at `time` [s], of the keyframes alone. RT: no allocation. Cost: O(log keyframes), one
  /// sine and cosine.
  [[nodiscard]] Pose poseAt(double time) const noexcept PALPATE_NONBLOCKING;
  /// How it deforms about p_W [m]: nothing without a warp. RT: no allocation. Cost: a reading of
  /// the warp, and the pose.
  [[nodiscard]] Deformation deformationAt(const Vec3& p_W,
                                          double time) const noexcept PALPATE_NONBLOCKING;
  /// The pose at `time` [s] with a deformation that is known about a place, ahead of its time or
  /// not. RT: no allocation. Cost: that of poseAt(time).
  [[nodiscard]] Pose poseAt(double time,
                            const Deformation& about) const noexcept PALPATE_NONBLOCKING;
  /// The pose at `time` [s] about p_W [m]. RT: no allocation.
  [[nodiscard]] Pose poseAbout(const Vec3& p_W, double time) const noexcept PALPATE_NONBLOCKING {
    return poseAt(time, deformationAt(p_W, time));
  }
  /// The pose at `time` [s] about what rests at p_rest [m]: where the warp has taken it is found by
  /// Newton's method, with at most 8 readings. RT: no allocation.
  [[nodiscard]] Pose poseOf(const Vec3& p_rest, double time) const noexcept PALPATE_NONBLOCKING;
  /// Its warp; null: it is rigid.
  [[nodiscard]] const WarpPtr& warp() const noexcept { return warp_; }

  /// A box in W that holds a box of the resting frame wherever the motion takes it, within 0.2 % of
  /// the radius at which its corners turn; with a warp, all that it can come to by that.
  [[nodiscard]] Box sweep(const Box& at_rest) const;
  /// A box of the resting frame with all that the warp can take what is in it to; without a warp
  /// the same.
  [[nodiscard]] Box deformed(const Box& at_rest) const;
  /// Upper bound of the speed of every point of a box of the resting frame [m/s]; with a warp, as
  /// that was sampled.
  [[nodiscard]] double topSpeed(const Box& rest) const;

  [[nodiscard]] std::size_t size() const noexcept { return knots_.size(); }  ///< Keyframes, >= 1.
  /// Time of the first keyframe [s], before which the volume stands at its pose.
  [[nodiscard]] double from() const noexcept { return knots_.front().time; }
  /// Time of the last keyframe [s], after which the volume stands, or begins again at from().
  [[nodiscard]] double to() const noexcept { return knots_.back().time; }
  [[nodiscard]] bool repeats() const noexcept { return repeat_; }  ///< Begins again after to().
  /// Unique in the process for every motion that is made.
  [[nodiscard]] std::uint64_t id() const noexcept { return id_; }

 private:
  /// A keyframe, and the motion from it to the next one.
  struct Knot {
    double time = 0.0;
    Pose pose;
    Vec3 axis = Vec3::UnitX();  ///< Axis of the turn in the resting frame, before `pose` turns it.
    double angle = 0.0;         ///< Angle of the turn [rad].
    Vec3 way = Vec3::Zero();    ///< Shift to the next keyframe [m].
  };
  [[nodiscard]] static Pose between(const Knot& knot, double share) noexcept PALPATE_NONBLOCKING;

  std::vector<Knot> knots_;
  WarpPtr warp_;
  bool repeat_ = false;
  std::uint64_t id_;
};

using MotionPtr = std::shared_ptr<const Motion>;  ///< Volumes of one pointer move together.

/// A motion within a tick: where its volumes are, and the proxy as seen from them.
struct Body {
  Pose pose;                    ///< Pose in this sub-step; of what deforms, about the last reading.
  Pose target;                  ///< Pose at the end of the tick, as it is foreseen at its begin.
  Deformation about;            ///< How it deforms, by the last reading.
  Deformation ahead;            ///< That by which `target` was foreseen.
  double sure = 0.0;            ///< How far off what is foreseen may be [m].
  Pose carry;                   ///< Motion from the last pose to this one, in W.
  Vec3 from = Vec3::Zero();     ///< The proxy before it moves, carried along, in the resting frame
                                ///< [m].
  Vec3 carried = Vec3::Zero();  ///< The proxy before it moves, carried along, in W [m].
  Vec3 seen = Vec3::Zero();     ///< Where properties are read, in the resting frame [m].
  Vec3 swept = Vec3::Zero();    ///< From `seen` to where the path to it ended, as the pose before
                                ///< the reading had it [m]: zero of a rigid one. Paths go on there.
  bool moved = false;           ///< The volume moved since the proxy; else `carried` is the proxy.
};

}  // namespace palpate
