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
/// for a volume that deforms, it is the linear map about one place.
struct Pose {
  Mat3 linear = Mat3::Identity();  ///< Linear part of the map; in a rigid map a rotation about W's
                                   ///< origin. Applied before `translate`.
  Mat3 back = Mat3::Identity();    ///< The inverse of `linear`.
  Vec3 translate = Vec3::Zero();   ///< Shift [m].

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
  /// Maps a vector that moves with the material, such as a velocity or a fibre's direction, to W.
  [[nodiscard]] Vec3 vector(const Vec3& v_rest) const noexcept { return linear * v_rest; }
  /// Maps a gradient, or a surface normal, to W.
  [[nodiscard]] Vec3 gradient(const Vec3& g_rest) const noexcept {
    return back.transpose() * g_rest;
  }
  /// Maps the spatial derivative of a gradient to W, if the pose does not vary near that place.
  [[nodiscard]] Mat3 gradientJacobian(const Mat3& of_rest) const noexcept {
    return back.transpose() * of_rest * back;
  }
  /// Maps the spatial derivative of a material vector to W, if the pose does not vary near that
  /// place.
  [[nodiscard]] Mat3 vectorJacobian(const Mat3& of_rest) const noexcept {
    return linear * of_rest * back;
  }
  /// Returns true if all numbers are exactly equal.
  [[nodiscard]] bool operator==(const Pose& other) const noexcept {
    return linear == other.linear && translate == other.translate;
  }
};

/// The pose of a volume at one time: a rotation about W's origin, followed by a shift.
struct Keyframe {
  double time = 0.0;                                ///< Time since the scene began [s].
  std::array<double, 4> rotation_wxyz{1, 0, 0, 0};  ///< Need not be normalised.
  Vec3 translate = Vec3::Zero();                    ///< Shift [m].
};

/// Motion of a volume. Between keyframes the volume rotates by the shorter arc and shifts, both at
/// constant rates. Before the first and after the last keyframe it stands still, unless the motion
/// repeats. A warp deforms the volume in the frame of this rigid motion. Const; shared by all
/// volumes that move together.
class Motion {
 public:
  /// Makes a motion from keyframes. Throws SceneError, with `path` before the JSON path of the
  /// error (such as /2/time), in these cases: there is no keyframe; times do not ascend or exceed
  /// 1e9 s; a shift is 1e6 m or more; a rotation is zero; two successive rotations are half a turn
  /// apart; a repeated motion has one keyframe or does not end at its start.
  explicit Motion(std::span<const Keyframe> keyframes, bool repeat = false,
                  const std::string& path = "/keyframes", WarpPtr warp = nullptr);
  /// Makes a motion that only deforms the volume.
  explicit Motion(WarpPtr warp);

  /// Returns the rigid pose of the keyframes at `time` [s]. RT: no allocation. Cost: O(log
  /// keyframes), one sine and cosine.
  [[nodiscard]] Pose poseAt(double time) const noexcept PALPATE_NONBLOCKING;
  /// Returns the deformation about p_W [m]; the identity without a warp. RT: no allocation. Cost: a
  /// reading of the warp, and the pose.
  [[nodiscard]] Deformation deformationAt(const Vec3& p_W,
                                          double time) const noexcept PALPATE_NONBLOCKING;
  /// Returns the pose at `time` [s] with a deformation that is already known, from the same or
  /// another time. RT: no allocation. Cost: that of poseAt(time).
  [[nodiscard]] Pose poseAt(double time,
                            const Deformation& about) const noexcept PALPATE_NONBLOCKING;
  /// Returns the pose at `time` [s] about p_W [m]. RT: no allocation.
  [[nodiscard]] Pose poseAbout(const Vec3& p_W, double time) const noexcept PALPATE_NONBLOCKING {
    return poseAt(time, deformationAt(p_W, time));
  }
  /// Returns the pose at `time` [s] about the material point that rests at p_rest [m]. Newton's
  /// method finds the point's present place, with at most 8 readings of the warp. RT: no
  /// allocation.
  [[nodiscard]] Pose poseOf(const Vec3& p_rest, double time) const noexcept PALPATE_NONBLOCKING;
  /// Returns the warp; null if the motion is rigid.
  [[nodiscard]] const WarpPtr& warp() const noexcept { return warp_; }

  /// Returns a box in W that contains a box of the resting frame at all times of the motion. It is
  /// exact to 0.2 % of the radius at which the corners turn. With a warp, the box contains all
  /// places that the material can reach.
  [[nodiscard]] Box sweep(const Box& at_rest) const;
  /// Returns a box, in the resting frame, of all places to which the warp can move the material of
  /// the box `at_rest`. Without a warp this is the same box.
  [[nodiscard]] Box deformed(const Box& at_rest) const;
  /// Returns an upper bound of the speed of the points in a box of the resting frame [m/s]. For a
  /// warp, the bound holds for the speed as sampled.
  [[nodiscard]] double topSpeed(const Box& rest) const;

  /// Number of keyframes, >= 1.
  [[nodiscard]] std::size_t size() const noexcept { return knots_.size(); }
  /// Returns the time of the first keyframe [s]. Until then the volume stands at the pose of that
  /// keyframe.
  [[nodiscard]] double from() const noexcept { return knots_.front().time; }
  /// Returns the time of the last keyframe [s]. Then the volume stands still, or the motion repeats
  /// from from().
  [[nodiscard]] double to() const noexcept { return knots_.back().time; }
  /// True if the motion repeats after to().
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
    double angle = 0.0;       ///< Angle of the rotation [rad].
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
  Pose target;        ///< Pose at the end of the tick, predicted at its begin.
  Deformation about;  ///< Deformation by the last reading.
  Deformation ahead;  ///< Deformation from which `target` was predicted.
  double sure = 0.0;  ///< A prediction with a larger error than this is replaced by a reading of
                      ///< the warp [m].
  Pose carry;         ///< Motion from the last pose to this one, in W.
  Vec3 from = Vec3::Zero();  ///< Place of the proxy before it moves, in the resting frame [m]. The
                             ///< volume carries it along.
  Vec3 carried = Vec3::Zero();  ///< The same place in W [m].
  Vec3 seen = Vec3::Zero();     ///< Place where properties are read, in the resting frame [m].
  Vec3 swept = Vec3::Zero();    ///< Vector from `seen` to the place where the path to `seen` ended,
                                ///< by the pose before the reading [m]. Zero for a rigid pose. The
                                ///< next path begins at that place.
  /// True if the volume has moved since the proxy last moved. If false, `carried` equals the proxy.
  bool moved = false;
};

}  // namespace palpate
