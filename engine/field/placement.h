/// Placement of a moving volume: rigid poses between keyframes, and its deformation.
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

/// A motion from a volume's resting frame, in which its field is given, into W. It is rigid; for a
/// volume that deforms, it is the motion about a place.
struct Pose {
  Mat3 linear = Mat3::Identity();  ///< If rigid, a rotation about W's origin, before `translate`.
  Mat3 back = Mat3::Identity();    ///< The inverse of `linear`.
  Vec3 translate = Vec3::Zero();   ///< [m]

  /// Returns the rigid motion that turns and then shifts.
  [[nodiscard]] static Pose rigid(const Mat3& rotation, const Vec3& translate) noexcept {
    return {rotation, rotation.transpose(), translate};
  }
  /// Maps a point of the resting frame to W [m].
  [[nodiscard]] Vec3 operator()(const Vec3& p_rest) const noexcept {
    return linear * p_rest + translate;
  }
  /// Maps a point p of W to the resting frame [m].
  [[nodiscard]] Vec3 toRest(const Vec3& p) const noexcept { return back * (p - translate); }
  /// Maps a vector of the matter, such as a velocity or a fibre's direction, to W.
  [[nodiscard]] Vec3 vector(const Vec3& v_rest) const noexcept { return linear * v_rest; }
  /// Maps a gradient, or the normal of a surface, to W.
  [[nodiscard]] Vec3 gradient(const Vec3& g_rest) const noexcept {
    return back.transpose() * g_rest;
  }
  /// Maps the derivative of a gradient by the place to W, if the pose is the same about that place.
  [[nodiscard]] Mat3 gradientJacobian(const Mat3& of_rest) const noexcept {
    return back.transpose() * of_rest * back;
  }
  /// Maps the derivative of a vector of the matter by the place to W, if the pose is the same about
  /// that place.
  [[nodiscard]] Mat3 vectorJacobian(const Mat3& of_rest) const noexcept {
    return linear * of_rest * back;
  }
  /// Returns true if all numbers are equal, without a tolerance.
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

/// Motion of a volume. Between keyframes it turns and shifts at constant rates, the turn by the
/// shorter arc. It is held before the first and after the last keyframe, or repeats. In the frame
/// that moves like this the volume may deform. Const; shared by the volumes that move together.
class Motion {
 public:
  /// Makes a motion by keyframes. Throws SceneError, with `path` before the JSON path of the error
  /// (/2/time), for no keyframe, times that do not ascend or are beyond 1e9 s, a shift of 1e6 m or
  /// more, a zero rotation, two in a row half a turn apart, or a repeated motion that has one
  /// keyframe or does not end where it began.
  explicit Motion(std::span<const Keyframe> keyframes, bool repeat = false,
                  const std::string& path = "/keyframes", WarpPtr warp = nullptr);
  /// Makes a motion that stands still and deforms.
  explicit Motion(WarpPtr warp);

  /// Returns the pose at `time` [s], by the keyframes alone. RT: no allocation. Cost: O(log
  /// keyframes), one sine and cosine.
  [[nodiscard]] Pose poseAt(double time) const noexcept PALPATE_NONBLOCKING;
  /// Returns the deformation about p_W [m]; without a warp, no deformation. RT: no allocation.
  /// Cost: a reading of the warp, and the pose.
  [[nodiscard]] Deformation deformationAt(const Vec3& p_W,
                                          double time) const noexcept PALPATE_NONBLOCKING;
  /// Returns the pose at `time` [s] with a known deformation about a place, of the same or another
  /// time. RT: no allocation. Cost: that of poseAt(time).
  [[nodiscard]] Pose poseAt(double time,
                            const Deformation& about) const noexcept PALPATE_NONBLOCKING;
  /// Returns the pose at `time` [s] about p_W [m]. RT: no allocation.
  [[nodiscard]] Pose poseAbout(const Vec3& p_W, double time) const noexcept PALPATE_NONBLOCKING {
    return poseAt(time, deformationAt(p_W, time));
  }
  /// Returns the pose at `time` [s] about the matter that rests at p_rest [m]. Newton's method
  /// finds where the warp has taken that matter, with at most 8 readings. RT: no allocation.
  [[nodiscard]] Pose poseOf(const Vec3& p_rest, double time) const noexcept PALPATE_NONBLOCKING;
  /// Returns the warp; null: the motion is rigid.
  [[nodiscard]] const WarpPtr& warp() const noexcept { return warp_; }

  /// Returns a box in W that holds a box of the resting frame wherever the motion takes it, within
  /// 0.2 % of the radius at which its corners turn. With a warp, the box holds all places that the
  /// matter can reach.
  [[nodiscard]] Box sweep(const Box& at_rest) const;
  /// Returns a box of all places to which the warp can take the matter of a box of the resting
  /// frame, in that frame; without a warp the same box.
  [[nodiscard]] Box deformed(const Box& at_rest) const;
  /// Returns an upper bound of the speed of every point of a box of the resting frame [m/s]; for a
  /// warp, of the speed as sampled.
  [[nodiscard]] double topSpeed(const Box& rest) const;

  [[nodiscard]] std::size_t size() const noexcept { return knots_.size(); }  ///< Keyframes, >= 1.
  /// Returns the time of the first keyframe [s], before which the volume stands at its pose.
  [[nodiscard]] double from() const noexcept { return knots_.front().time; }
  /// Returns the time of the last keyframe [s], after which the volume stands, or begins again at
  /// from().
  [[nodiscard]] double to() const noexcept { return knots_.back().time; }
  [[nodiscard]] bool repeats() const noexcept { return repeat_; }  ///< Begins again after to().
  /// Returns the id of the motion, unique in the process.
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

using MotionPtr = std::shared_ptr<const Motion>;  ///< Volumes with the same pointer move together.

/// A motion within a tick: the pose of its volumes, and the proxy as seen from them.
struct Body {
  Pose pose;                    ///< Pose in this sub-step; of a volume that deforms, about the last
                                ///< reading.
  Pose target;                  ///< Pose at the end of the tick, predicted at its begin.
  Deformation about;            ///< Deformation by the last reading.
  Deformation ahead;            ///< Deformation by which `target` was predicted.
  double sure = 0.0;            ///< Largest error of a prediction before the warp is read again
                                ///< [m].
  Pose carry;                   ///< Motion from the last pose to this one, in W.
  Vec3 from = Vec3::Zero();     ///< Proxy before it moves, carried along, in the resting frame [m].
  Vec3 carried = Vec3::Zero();  ///< Proxy before it moves, carried along, in W [m].
  Vec3 seen = Vec3::Zero();     ///< Place where properties are read, in the resting frame [m].
  Vec3 swept = Vec3::Zero();    ///< Vector from `seen` to the end of the path to it, by the pose
                                ///< before the reading [m]; zero if rigid. Paths continue from
                                ///< there.
  bool moved = false;           ///< The volume moved since the proxy did; else `carried` is the
                                ///< proxy.
};

}  // namespace palpate
