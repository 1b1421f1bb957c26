/// Where a moving volume is: rigid poses between keyframes.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate {

/// A rigid motion out of a volume's resting frame, the one that its field is given in, into W.
struct Pose {
  Mat3 rotation = Mat3::Identity();  ///< Turn about W's origin, before `translate`.
  Vec3 translate = Vec3::Zero();     ///< [m]

  /// Where a point of the resting frame is in W [m].
  [[nodiscard]] Vec3 operator()(const Vec3& p_rest) const noexcept {
    return rotation * p_rest + translate;
  }
  /// The point of the resting frame that is at p in W [m].
  [[nodiscard]] Vec3 toRest(const Vec3& p) const noexcept {
    return rotation.transpose() * (p - translate);
  }
  /// True if all numbers are equal, without a tolerance.
  [[nodiscard]] bool operator==(const Pose& other) const noexcept {
    return rotation == other.rotation && translate == other.translate;
  }
};

/// A volume's pose at one time: the volume turns about W's origin, then shifts.
struct Keyframe {
  double time = 0.0;                                ///< Time since the scene began [s].
  std::array<double, 4> rotation_wxyz{1, 0, 0, 0};  ///< Normalised when used.
  Vec3 translate = Vec3::Zero();                    ///< [m]
};

/// How a volume moves: turned evenly the short way round and shifted evenly from keyframe to
/// keyframe, held before the first and after the last, or repeated. Const; shared by the volumes
/// that move together.
class Motion {
 public:
  /// Throws SceneError, with `path` before what is wrong (/2/time), for no keyframe, times that do
  /// not ascend or are beyond 1e9 s, a shift of 1e6 m or more, a zero rotation, two in a row half
  /// a turn apart, or a repeated motion that has one keyframe or does not end where it began.
  explicit Motion(std::span<const Keyframe> keyframes, bool repeat = false,
                  const std::string& path = "/keyframes");

  /// The pose at `time` [s]. RT: no allocation. Cost: O(log keyframes), one sine and cosine.
  [[nodiscard]] Pose poseAt(double time) const noexcept PALPATE_NONBLOCKING;

  /// A box in W that holds a box of the resting frame wherever the motion takes it, within 0.2 % of
  /// the radius at which its corners turn.
  [[nodiscard]] Box sweep(const Box& rest) const;
  /// Upper bound of the speed of every point of a box of the resting frame [m/s].
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
  bool repeat_ = false;
  std::uint64_t id_;
};

using MotionPtr = std::shared_ptr<const Motion>;  ///< Volumes of one pointer move together.

/// A motion within a tick: where its volumes are, and the proxy as seen from them.
struct Body {
  Pose pose;                    ///< Pose in this sub-step.
  Pose target;                  ///< Pose at the end of the tick.
  Pose carry;                   ///< Motion from the last pose to this one, in W.
  Vec3 from = Vec3::Zero();     ///< The proxy before it moves, carried along, in the resting frame
                                ///< [m].
  Vec3 carried = Vec3::Zero();  ///< The proxy before it moves, carried along, in W [m].
  Vec3 seen = Vec3::Zero();     ///< Where properties are read, in the resting frame [m].
  bool moved = false;           ///< The volume moved since the proxy; else `carried` is the proxy.
};

}  // namespace palpate
