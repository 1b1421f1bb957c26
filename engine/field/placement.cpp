#include "palpate/engine/field/placement.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <utility>

#include <Eigen/Geometry>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

std::array<Vec3, 8> cornersOf(const Box& box) {
  std::array<Vec3, 8> corners;
  for (std::size_t i = 0; i < 8; ++i) {
    corners[i] = {(i & 1U) != 0 ? box.upper.x() : box.lower.x(),
                  (i & 2U) != 0 ? box.upper.y() : box.lower.y(),
                  (i & 4U) != 0 ? box.upper.z() : box.lower.z()};
  }
  return corners;
}

std::uint64_t nextMotionId() noexcept {
  static std::atomic<std::uint64_t> next{1};
  return next++;
}

}  // namespace

Motion::Motion(WarpPtr warp) : knots_(1), warp_(std::move(warp)), id_(nextMotionId()) {}

Motion::Motion(std::span<const Keyframe> keyframes, bool repeat, const std::string& path,
               WarpPtr warp)
    : warp_(std::move(warp)), repeat_(repeat), id_(nextMotionId()) {
  if (keyframes.empty()) {
    throw SceneError(path, "there is no keyframe", "give one, or remove \"keyframes\"");
  }
  std::vector<Eigen::Quaterniond> turns;
  for (std::size_t i = 0; i < keyframes.size(); ++i) {
    const Keyframe& key = keyframes[i];
    const std::string here = path + "/" + std::to_string(i);
    if (!(std::abs(key.time) <= 1e9)) {
      throw SceneError(here + "/time", "the time is not within +-1e9 s (about 32 years)",
                       "give seconds from -1e9 to 1e9");
    }
    if (i > 0 && !(key.time > keyframes[i - 1].time)) {
      throw SceneError(here + "/time", "the time is not later than that of the keyframe before",
                       "sort the keyframes by time, and drop equal times");
    }
    const auto& q = key.rotation_wxyz;
    const Eigen::Quaterniond turn(q[0], q[1], q[2], q[3]);
    if (!(turn.norm() > 1e-6) || !std::isfinite(turn.norm())) {
      throw SceneError(here + "/rotation_wxyz", "the quaternion is zero or not finite",
                       "give w, x, y, z, such as [1, 0, 0, 0]");
    }
    if (!(key.translate.norm() < 1e6)) {
      throw SceneError(here + "/translate", "the position is not within 1,000 km of the origin",
                       "give metres");
    }
    turns.push_back(turn.normalized());
    knots_.push_back({key.time, Pose::rigid(turns.back().toRotationMatrix(), key.translate)});
    if (i == 0) continue;
    Eigen::Quaterniond way = turns[i - 1].conjugate() * turns[i];
    if (std::abs(way.w()) < 1e-6) {
      throw SceneError(here + "/rotation_wxyz",
                       "a half turn from the keyframe before has an ambiguous direction",
                       "put a keyframe between them");
    }
    if (way.w() < 0.0) way.coeffs() = -way.coeffs();
    Knot& last = knots_[i - 1];
    const double sine = way.vec().norm();
    last.angle = 2.0 * std::atan2(sine, way.w());
    if (turns[i - 1].coeffs() == turns[i].coeffs()) last.angle = 0.0;
    if (sine > 0.0) last.axis = way.vec() / sine;
    last.way = key.translate - last.pose.translate;
  }
  if (!repeat_) return;
  if (knots_.size() < 2) {
    throw SceneError(path, "a motion of one keyframe cannot repeat",
                     "give two or more keyframes, or remove \"repeat\"");
  }
  constexpr double kSame = 1e-6;
  const double turned = turns.front().angularDistance(turns.back());
  const double shifted = (knots_.back().pose.translate - knots_.front().pose.translate).norm();
  if (turned > kSame || shifted > kSame) {
    throw SceneError(path + "/" + std::to_string(knots_.size() - 1),
                     "a repeated motion must end where it began",
                     "give the last keyframe the pose of the first, or remove \"repeat\"");
  }
}

Pose Motion::between(const Knot& knot, double share) noexcept {
  Pose pose = knot.pose;
  pose.translate += share * knot.way;
  if (knot.angle != 0.0) {
    pose.linear = pose.linear * Eigen::AngleAxisd(share * knot.angle, knot.axis).matrix();
    pose.back = pose.linear.transpose();
  }
  return pose;
}

Pose Motion::poseAt(double time) const noexcept {
  if (repeat_ && time > to()) time = from() + std::fmod(time - from(), to() - from());
  const auto next = std::upper_bound(knots_.begin(), knots_.end(), time,
                                     [](double t, const Knot& knot) { return t < knot.time; });
  if (next == knots_.begin()) return knots_.front().pose;
  if (next == knots_.end()) return knots_.back().pose;
  const Knot& last = *(next - 1);
  return between(last, (time - last.time) / (next->time - last.time));
}

Deformation Motion::deformationAt(const Vec3& p_W, double time) const noexcept {
  if (warp_ == nullptr) return {};
  return palpate::deformationAt(*warp_, poseAt(time).toRest(p_W), time);
}

Pose Motion::poseAt(double time, const Deformation& about) const noexcept {
  Pose pose = poseAt(time);
  if (warp_ == nullptr) return pose;
  // p = R x + t, x = F^-1 (X - origin - rate (time - about.time))
  pose.linear = pose.linear * about.back;
  pose.back = about.slope * pose.back;
  pose.translate -= pose.linear * (about.origin + (time - about.time) * about.rate);
  return pose;
}

Pose Motion::poseOf(const Vec3& p_rest, double time) const noexcept {
  if (warp_ == nullptr) return poseAt(time);
  constexpr int kMost = 8;
  constexpr double kThere = 1e-9;  // [m]: Newton's method ends after a step of at most this length
  Vec3 x = p_rest;
  Deformation about;
  for (int i = 0; i < kMost; ++i) {
    about = palpate::deformationAt(*warp_, x, time);
    const Vec3 step = about.back * (p_rest - about.origin) - x;
    x += step;
    if (!(step.norm() > kThere)) break;
  }
  return poseAt(time, about);
}

Box Motion::deformed(const Box& at_rest) const {
  if (warp_ == nullptr) return at_rest;
  const Box shifts = warp_->shifts();
  return {at_rest.lower + shifts.lower, at_rest.upper + shifts.upper};
}

Box Motion::sweep(const Box& at_rest) const {
  // [rad]: the middle of an arc of this angle is 0.05^2 / 2 radii away from its chord
  constexpr double kStep = 0.1;
  Box box;
  if (at_rest.empty()) return box;
  const Box rest = deformed(at_rest);
  for (const Knot& knot : knots_) {
    const int steps = 1 + static_cast<int>(knot.angle / kStep);
    for (int i = 0; i < steps; ++i) {
      const Pose pose = between(knot, static_cast<double>(i) / steps);
      for (const Vec3& corner : cornersOf(rest)) box.extend(pose(corner));
    }
  }
  return box;
}

double Motion::topSpeed(const Box& rest) const {
  double radius = 0.0;
  for (const Vec3& corner : cornersOf(rest)) radius = std::max(radius, corner.norm());
  double speed = 0.0;
  for (std::size_t i = 0; i + 1 < knots_.size(); ++i) {
    const Knot& knot = knots_[i];
    const double seconds = knots_[i + 1].time - knot.time;
    speed = std::max(speed, (knot.way.norm() + knot.angle * radius) / seconds);
  }
  if (warp_ != nullptr) speed += warp_->topSpeed();
  return speed;
}

}  // namespace palpate
