/// Placement of a moving volume: its rigid poses between keyframes, and its deformation.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/field/warp.h"
#include "palpate/engine/types.h"

namespace palpate {

/// A map from the resting frame of a volume, in which its field is given, to W. The map is rigid;
/// for a volume that deforms, it is the deformation linearised at one point.
struct Pose {
  /// Linear part, applied before `translate`; a rotation if the map is rigid.
  Mat3 linear = Mat3::Identity();
  Mat3 back = Mat3::Identity();   ///< The inverse of `linear`.
  Vec3 translate = Vec3::Zero();  ///< Shift [m].

  /// Returns the rigid map that first rotates and then shifts.
  [[nodiscard]] static Pose rigid(const Mat3& rotation, const Vec3& translate) noexcept {
    return {rotation, rotation.transpose(), translate};
  }
  /// Maps a point of the resting frame to W [m].
  [[nodiscard]] Vec3 operator()(const Vec3& p_rest) const noexcept {
    return linear * p_rest + translate;
  }
  /// Maps a point p of W to the resting frame [m].
  [[nodiscard]] Vec3 toRest(const Vec3& p) const noexcept { return back * (p - translate); }
  /// Maps a vector that moves with the material, such as a fibre's direction, to W.
  [[nodiscard]] Vec3 vector(const Vec3& v_rest) const noexcept { return linear * v_rest; }
  /// Maps a gradient, or a surface normal, to W. A mapped normal may not have unit length.
  [[nodiscard]] Vec3 gradient(const Vec3& g_rest) const noexcept {
    return back.transpose() * g_rest;
  }
  /// Maps the spatial derivative of a gradient to W, if the pose does not vary nearby.
  [[nodiscard]] Mat3 gradientJacobian(const Mat3& of_rest) const noexcept {
    return back.transpose() * of_rest * back;
  }
  /// Maps the spatial derivative of a material vector to W, if the pose does not vary nearby.
  [[nodiscard]] Mat3 vectorJacobian(const Mat3& of_rest) const noexcept {
    return linear * of_rest * back;
  }
  /// Returns true if `linear` and `translate` are exactly equal. Does not compare `back`, which
  /// follows from `linear`.
  [[nodiscard]] bool operator==(const Pose& other) const noexcept {
    return linear == other.linear && translate == other.translate;
  }
};

/// The pose of a volume at one time: a rotation about W's origin, followed by a shift.
struct Keyframe {
  double time = 0.0;                                ///< Time since the proxy entered the scene [s].
  std::array<double, 4> rotation_wxyz{1, 0, 0, 0};  ///< Quaternion; need not be normalised.
  Vec3 translate = Vec3::Zero();                    ///< Shift [m].
};

/// Motion of a volume. Between keyframes the volume rotates by the shorter arc and shifts, both at
/// constant rates. Before the first keyframe the volume stands still. After the last keyframe it
/// stands still, or the motion repeats. A warp deforms the volume in the frame of this rigid
/// motion. Const; several volumes may share a motion.
class Motion {
 public:
  /// Makes a motion from keyframes. `path` is the JSON path of the keyframes, for messages. Throws
  /// SceneError in these cases: there is no keyframe; times do not ascend or are not within +-1e9
  /// s; a shift is 1e6 m or more, or not finite; a quaternion has a norm of at most 1e-6, or is not
  /// finite; two successive rotations are half a turn apart; a repeated motion has one keyframe, or
  /// its ends differ by more than 1e-6 m or rad.
  explicit Motion(std::span<const Keyframe> keyframes, bool repeat = false,
                  const std::string& path = "/keyframes", WarpPtr warp = nullptr);
  /// Makes a motion that only deforms the volume; its only keyframe is the identity at 0 s.
  explicit Motion(WarpPtr warp);

  /// Returns the keyframes' rigid pose at `time` [s]. RT: no allocation. Cost: O(log keyframes).
  [[nodiscard]] Pose poseAt(double time) const noexcept PALPATE_NONBLOCKING;
  /// Returns the deformation about p_W [m]; the identity without a warp. RT: no allocation. Cost: a
  /// reading of the warp, and the pose.
  [[nodiscard]] Deformation deformationAt(const Vec3& p_W,
                                          double time) const noexcept PALPATE_NONBLOCKING;
  /// Returns the pose at `time` [s] with a known deformation, which may be of another time. RT: no
  /// allocation.
  [[nodiscard]] Pose poseAt(double time,
                            const Deformation& about) const noexcept PALPATE_NONBLOCKING;
  /// Returns the pose at `time` [s] about p_W [m]. RT: no allocation.
  [[nodiscard]] Pose poseAbout(const Vec3& p_W, double time) const noexcept PALPATE_NONBLOCKING {
    return poseAt(time, deformationAt(p_W, time));
  }
  /// Returns the pose at `time` [s] about the material point that rests at p_rest [m]. Newton's
  /// method finds the point's place, with at most 8 readings of the warp. RT: no allocation.
  [[nodiscard]] Pose poseOf(const Vec3& p_rest, double time) const noexcept PALPATE_NONBLOCKING;
  /// Returns the warp; null if the motion is rigid.
  [[nodiscard]] const WarpPtr& warp() const noexcept { return warp_; }

  /// Returns a box in W that contains, at all times, the material of the box `at_rest` of the
  /// resting frame. Faces may be off by 0.2 % of the radius of the corners' arcs.
  [[nodiscard]] Box sweep(const Box& at_rest) const;
  /// Returns a box, in the resting frame, of all places to which the warp can move the material of
  /// the box `at_rest`. Without a warp the function returns `at_rest`.
  [[nodiscard]] Box deformed(const Box& at_rest) const;
  /// Returns an upper bound of the speed of the points in a box of the resting frame [m/s], moved
  /// by the keyframes. Adds Warp::topSpeed(), which is not a strict bound.
  [[nodiscard]] double topSpeed(const Box& rest) const;

  /// Returns the number of keyframes, >= 1.
  [[nodiscard]] std::size_t size() const noexcept { return knots_.size(); }
  /// Returns the time of the first keyframe [s]; until then the volume stands still.
  [[nodiscard]] double from() const noexcept { return knots_.front().time; }
  /// Returns the time of the last keyframe [s], when the motion ends or repeats.
  [[nodiscard]] double to() const noexcept { return knots_.back().time; }
  /// Returns true if the motion repeats after to().
  [[nodiscard]] bool repeats() const noexcept { return repeat_; }
  /// Returns the id of the motion, unique in the process.
  [[nodiscard]] std::uint64_t id() const noexcept { return id_; }

 private:
  /// A keyframe, and the motion from it to the next one.
  struct Knot {
    double time = 0.0;
    Pose pose;
    /// Axis of the rotation in the resting frame, before `pose` rotates it.
    Vec3 axis = Vec3::UnitX();
    double angle = 0.0;       ///< Angle of the rotation to the next keyframe [rad].
    Vec3 way = Vec3::Zero();  ///< Shift to the next keyframe [m].
  };
  [[nodiscard]] static Pose between(const Knot& knot, double share) noexcept PALPATE_NONBLOCKING;

  std::vector<Knot> knots_;
  WarpPtr warp_;
  bool repeat_ = false;
  std::uint64_t id_;
};

using MotionPtr = std::shared_ptr<const Motion>;  ///< Volumes with the same pointer move together.

/// The motion of one or more volumes within a tick: their pose, and the proxy relative to them.
struct Body {
  /// Pose in this sub-step; for a volume that deforms, the pose about the last reading.
  Pose pose;
  Pose target;               ///< Pose at the end of the tick, predicted at the start of the tick.
  Deformation about;         ///< Deformation that was read last.
  Deformation ahead;         ///< Deformation from which `target` was predicted.
  double sure = 0.0;         ///< Largest accepted error of a predicted deformation [m].
  Pose carry;                ///< Motion from the last pose to `pose`, in W.
  Vec3 from = Vec3::Zero();  ///< Place of the proxy before it moves, in the resting frame [m].
  Vec3 carried =
      Vec3::Zero();          ///< `from` in W [m]: the place to which the volume carries the proxy.
  Vec3 seen = Vec3::Zero();  ///< Place where properties are read, in the resting frame [m].
  /// `seen` by the pose before the last reading, minus `seen` by the pose after it [m]. The next
  /// swept path begins at seen + swept. Zero for a rigid pose.
  Vec3 swept = Vec3::Zero();
  /// True if the volume has moved since Bodies::stand(). If false, `carried` equals the proxy.
  bool moved = false;
};

}  // namespace palpate
