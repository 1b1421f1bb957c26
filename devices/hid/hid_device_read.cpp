#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Geometry>

#include "palpate/devices/hid/hid_device.h"
#include "palpate/devices/hid/profile_facts.h"

namespace palpate {

namespace {

constexpr std::int64_t kWriteTime = 20000000;  // [ns]: a write that takes longer is blocked
// [s]: longest time for which one read moves a rate-controlled position, or raises the share of the
// weight that the motors carry.
constexpr double kLongestStep = 0.02;

}  // namespace

void HidDevice::follow(double dt) noexcept {
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const HidJoint& joint = profile_.joints[i];
    const ReportField& field = profile_.input[joint.from.report].fields[joint.from.field];
    double raw = input_.raw(joint.from);
    if (field.wraps) raw = counters_[i].follow(raw, field.bits, about_[i]);
    joints_[i] = jointAt(profile_, i, raw, home_raw_[i]);
  }
  pose_ = profile_.kinematics->at(joints_);
  const Vec3 position_W = profile_.world_from_device * (pose_.position_D - profile_.origin_D);
  if (profile_.rate_control <= 0.0) {
    position_W_ = position_W;
    return;
  }
  position_W_ += profile_.rate_control * std::min(dt, kLongestStep) * position_W;
  const double reach = profile_.limits.workspace_radius;
  if (position_W_.norm() > reach) position_W_ *= reach / position_W_.norm();
}

void HidDevice::lookAtHandle() noexcept {
  Handle handle;
  std::copy(joints_.begin(), joints_.begin() + static_cast<std::ptrdiff_t>(profile_.joints.size()),
            handle.joints.begin());
  const HidHandle& of = profile_.handle;
  for (std::size_t i = 0; i < of.buttons.size(); ++i) {
    const bool pressed = input_.known(of.buttons[i].field.report) &&
                         input_.raw(of.buttons[i].field) == of.buttons[i].equals;
    handle.buttons |= static_cast<std::uint32_t>(pressed) << i;
  }
  const auto angle_of = [&](const HidTurn& turn) {
    if (turn.joint) return joints_[*turn.joint];
    const ReportField& field = profile_.input[turn.from.report].fields[turn.from.field];
    return (field.scale * input_.raw(turn.from) + field.offset) / turn.ratio + turn.home;
  };
  if (of.gripper) handle.gripper = angle_of(*of.gripper);
  Eigen::Quaterniond turned(profile_.world_from_device);
  for (const HidTurn& turn : of.orientation) {
    turned = turned * Eigen::AngleAxisd(angle_of(turn), turn.axis);
  }
  turned.normalize();
  if (!of.orientation.empty()) {
    handle.orientation = {turned.w(), turned.x(), turned.y(), turned.z()};
  }
  // A float field may have any value. If one is not finite, the handle keeps its last joints,
  // gripper and orientation.
  bool finite = std::isfinite(handle.gripper) && turned.coeffs().allFinite();
  for (const double joint : handle.joints) finite = finite && std::isfinite(joint);
  if (!finite) {
    handle.joints = handle_.joints;
    handle.gripper = handle_.gripper;
    handle.orientation = handle_.orientation;
  }
  handle_ = handle;
}

HandState HidDevice::read() noexcept {
  HandState hand;
  const std::int64_t now = host_.now();
  const double dt = 1e-9 * static_cast<double>(now - read_at_);
  read_at_ = now;
  readReports(now, dt, hand);
  hand.position = position_W_;
  lookAtHandle();
  hand.handle = handle_;
  hand.drives = drivesHere();
  hand.age = silent() ? 0.0 : 1e-9 * static_cast<double>(now - heard_at_);
  hand.ready = pose_.reachable && (heard_ || silent());
  if (profile_.output && !numbered_) hand.still = 1e-9 * static_cast<double>(now - moved_at_);
  applyFlags(hand);
  lookAtFlags(now, hand);
  lookAtWrites(now, hand);
  // The motors take up the weight as slowly as a force grows after a start, and release it at once.
  upright_ = hand.ready && hand.fault == Fault::kNone && hand.age <= profile_.limits.stale;
  const double step = std::min(dt, kLongestStep) / kEngage;
  carried_share_ = carries_ && upright_ ? std::min(1.0, carried_share_ + step) : 0.0;
  return hand;
}

void HidDevice::readReports(std::int64_t now, double dt, HandState& hand) noexcept {
  const Using port(open_port_, reading_);
  const std::uint32_t plugging = plugging_;
  if (port && plugging != plugging_seen_) {
    plugging_seen_ = plugging;
    adoptMended(now);
  }
  // The arm may have moved since the opening. So the counters start again at the first tick, unless
  // palpate homed the arm at the opening or took its pose there as the home pose.
  if (!std::exchange(ticked_, true) && !profile_.home_at_open && profile_.home.empty()) {
    forgetCounters();
  }
  // After a pause, the waiting reports are old. Their position is not used, except that of a 3D
  // mouse.
  const bool paused = dt > profile_.limits.stale;
  if (paused) forgetReports(now);
  ReadStatus got = port ? input_.takeNewest(*port) : ReadStatus::kGone;
  if (paused && got == ReadStatus::kReport && !silent()) got = ReadStatus::kNothing;
  // If counters may have wrapped unnoticed, only homing can give the position again.
  if (got == ReadStatus::kReport && !countedOn(1e-9 * static_cast<double>(now - counted_at_))) {
    miscounted_ = true;
    got = ReadStatus::kGone;
    hand.fault = Fault::kMiscounted;
  }
  if (got == ReadStatus::kGone) {
    if (port) lost();
    if (hand.fault == Fault::kNone) hand.fault = Fault::kGone;
  }
  if (got == ReadStatus::kReport) {
    counted_at_ = now;
    heard_ = true;
    heard_at_ = now;
    lookForMotion(now);
  }
  for (std::size_t r = 0; r < flags_at_.size(); ++r) {
    if (input_.came(r) && !paused) flags_at_[r] = now;
  }
  // A 3D mouse repeats its report while it is deflected. The last report is valid until it is
  // stale.
  const double since = 1e-9 * static_cast<double>(now - heard_at_);
  const double moves = std::clamp(profile_.limits.stale - (since - dt), 0.0, dt);
  if (got == ReadStatus::kReport || (got == ReadStatus::kNothing && silent())) follow(moves);
}

void HidDevice::adoptMended(std::int64_t now) noexcept {
  heard_ = false;
  heard_at_ = written_at_ = now;
  forgetCounters();
  input_.adopt(mended_);
  moved_at_ = now;
  knowFlags(now);
}

void HidDevice::forgetReports(std::int64_t now) noexcept {
  heard_ = false;
  if (!silent()) heard_at_ = now;
  moved_at_ = written_at_ = now;
  std::fill(flags_at_.begin(), flags_at_.end(), kNever);
}

void HidDevice::forgetCounters() noexcept {
  for (Unwrapped& counter : counters_) counter.forget();
}

void HidDevice::applyFlags(HandState& hand) noexcept {
  for (const HidFlag& flag : profile_.flags) {
    // lookAtFlags() handles a flag that has not come yet.
    if (!silent() && flags_at_[flag.field.report] == kNever) continue;
    const bool says = input_.raw(flag.field) == flag.equals;
    // Homing resets the device's counters, so their values before homing must not be used as a
    // reference.
    if (flag.means == HidFlag::Means::kHomed && !says) forgetCounters();
    if (flag.means == HidFlag::Means::kHomed || flag.means == HidFlag::Means::kEnabled) {
      hand.ready = hand.ready && says;
    } else if (says && hand.fault == Fault::kNone) {
      hand.fault = flag.means == HidFlag::Means::kHot         ? Fault::kTemperature
                   : flag.means == HidFlag::Means::kUnpowered ? Fault::kPower
                                                              : Fault::kSwitch;
    }
  }
}

void HidDevice::lookAtFlags(std::int64_t now, HandState& hand) noexcept {
  for (std::size_t r = 0; r < flags_in_.size(); ++r) {
    if (!flags_in_[r]) continue;
    const double stale = profile_.input[r].stale;
    const double age = 1e-9 * static_cast<double>(now - flags_at_[r]);
    if (flags_at_[r] == kNever) {
      hand.ready = false;
    } else if (age > (stale > 0.0 ? stale : profile_.limits.stale) && hand.fault == Fault::kNone) {
      hand.fault = Fault::kStale;
    }
  }
}

void HidDevice::lookAtWrites(std::int64_t now, HandState& hand) noexcept {
  if (const std::uint32_t written = written_; written != written_seen_) {
    written_seen_ = written;
    written_at_ = now;
  }
  if (written_seen_ == sent_ || hand.fault != Fault::kNone) return;
  const auto period = static_cast<std::int64_t>(1e9 / profile_.output_rate);
  if (now - written_at_ > kWriteTime + period) hand.fault = Fault::kWrite;
}

void HidDevice::lookForMotion(std::int64_t now) noexcept {
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const double raw = input_.raw(profile_.joints[i].from);
    // A changed count proves that the position is still measured only if the joint moves the tip.
    if (raw != counts_[i] && !pose_.jacobian[i].isZero(0.0)) moved_at_ = now;
    counts_[i] = raw;
  }
}

Mat3 HidDevice::drivesHere() const noexcept {
  Mat3 onto = drives_W_;
  // A joint without a motor turns freely, so no force can act in the direction of its motion.
  for (const std::size_t i : undriven_) {
    const Vec3 free = onto * (profile_.world_from_device * pose_.jacobian[i]);
    constexpr double kNone = 1e-6;  // [m/rad]: shorter levers count as zero
    if (free.norm() > kNone) onto -= free * free.transpose() / free.squaredNorm();
  }
  return onto;
}

bool HidDevice::countedOn(double pause) const noexcept {
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const HidJoint& joint = profile_.joints[i];
    const ReportField& field = profile_.input[joint.from.report].fields[joint.from.field];
    if (!field.wraps || !counters_[i].known()) continue;
    // Travel of the tip per joint unit. It vanishes at singular poses, so it gets a lower bound.
    const double lever = std::max(pose_.jacobian[i].norm(), profile_.limits.workspace_radius);
    const double half =
        std::ldexp(std::abs(field.scale / joint.ratio), static_cast<int>(field.bits) - 1);
    // Assumed largest distance between two positions of the tip [workspace radii]. Even in a long
    // pause, the tip does not move farther.
    constexpr double kReach = 3.0;
    const double farthest =
        std::min(profile_.limits.speed * pause, kReach * profile_.limits.workspace_radius);
    if (lever * half < farthest) return false;
  }
  return true;
}

std::string HidDevice::whyNotReady() const {
  for (const HidFlag& flag : profile_.flags) {
    if (!silent() && flags_at_[flag.field.report] == kNever) continue;  // not known: see below
    if (input_.raw(flag.field) == flag.equals) continue;
    if (flag.means == HidFlag::Means::kHomed) return "the arm is not homed: home it";
    if (flag.means == HidFlag::Means::kEnabled) {
      return "the dead-man switch is open: hold it closed";
    }
  }
  if (!heard_ && !silent()) {
    return "no position arrives: check the arm's cable, and end other programs that use the arm";
  }
  for (std::size_t r = 0; r < flags_in_.size(); ++r) {
    if (!flags_in_[r] || flags_at_[r] != kNever) continue;
    return "the report with " + profile_.input[r].fields.front().name +
           " does not arrive: check the firmware, which must send this report repeatedly";
  }
  if (!pose_.reachable) {
    return "the joint values do not fit the arm's geometry: home the arm, or correct the profile's "
           "kinematics";
  }
  return {};
}

std::vector<double> HidDevice::steps() const {
  const auto all = resolution();
  return {all.begin(), all.begin() + static_cast<std::ptrdiff_t>(profile_.joints.size())};
}

std::array<double, kMostJoints> HidDevice::resolution() const noexcept {
  std::array<double, kMostJoints> steps{};
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const HidJoint& joint = profile_.joints[i];
    const ReportField& field = profile_.input[joint.from.report].fields[joint.from.field];
    steps[i] = pose_.jacobian[i].norm() * std::abs(field.scale / joint.ratio);
  }
  return steps;
}

}  // namespace palpate
