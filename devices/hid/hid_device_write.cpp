#include <algorithm>
#include <cmath>
#include <span>

#include "palpate/devices/arm/pace.h"
#include "palpate/devices/hid/hid_device.h"
#include "palpate/devices/hid/profile_facts.h"

namespace palpate {

namespace {

// [ns]: longest sleep of the writer thread, so that the thread soon ends if the device is closed.
constexpr std::int64_t kLongestSleep = 1000000;

}  // namespace

double HidDevice::heatMotors() noexcept {
  const std::int64_t now = host_.now();
  const double dt = told_at_ == 0 ? 0.0 : 1e-9 * static_cast<double>(now - told_at_);
  told_at_ = now;
  for (MotorHeat& motor : heat_) motor.pass(dt);
  return dt;
}

std::array<double, kMostJoints> HidDevice::carried() const noexcept {
  std::array<double, kMostJoints> raw{};
  const double share = carries_ && upright_ ? carried_share_ : 0.0;
  if (profile_.masses.empty() || share <= 0.0) return raw;
  const Joints torques = carryingTorques(profile_, joints_);
  double most = 1.0;
  if (!tested_) {
    const double weight = forceOf(profile_, pose_, torques).norm();
    if (!(weight <= host_.carries)) most = host_.carries / weight;
  }
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const HidJoint& joint = profile_.joints[i];
    if (!joint.to) continue;
    const ReportField& field = profile_.output->fields[*joint.to];
    raw[i] = field.scale * torques[i] / (joint.ratio * joint.torque_constant);
    double room = raw[i] > 0.0 ? field.most - field.offset : field.offset - field.least;
    if (joint.continuous > 0.0) room = std::min(room, joint.continuous * std::abs(field.scale));
    if (std::abs(raw[i]) > room) most = std::min(most, std::max(room, 0.0) / std::abs(raw[i]));
  }
  for (double& r : raw) {
    r *= most * share;
    if (!std::isfinite(r)) return {};
  }
  return raw;
}

void HidDevice::encode(const Vec3& force_W, std::span<std::byte> report) noexcept {
  const double dt = heatMotors();
  for (MotorHeat& motor : heat_) motor.tell(0.0);
  std::copy(zero_.begin(), zero_.end(), report.begin());
  const Vec3 force_D = profile_.world_from_device.transpose() * (drivesHere() * force_W);
  // If a motor's limit is exceeded, reduces all motors by the same share, so that the force keeps
  // its direction.
  std::array<double, kMostJoints> raw{};
  std::array<double, kMostJoints> room{};
  const std::array<double, kMostJoints> weight = carried();
  double share = 1.0;
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const HidJoint& joint = profile_.joints[i];
    if (!joint.to) continue;
    const ReportField& field = profile_.output->fields[*joint.to];
    const double none = field.offset + weight[i];
    raw[i] =
        field.scale * Kinematics::torque(pose_, i, force_D) / (joint.ratio * joint.torque_constant);
    if (!std::isfinite(raw[i])) {
      given_ = 0.0;
      return;
    }
    const double end = raw[i] > 0.0 ? field.most - none : none - field.least;
    room[i] = std::max(end, 0.0);
    if (std::abs(raw[i]) > room[i]) share = std::min(share, room[i] / std::abs(raw[i]));
  }
  // Also reduces all motors if a motor's heat does not permit its part of the force in addition to
  // the weight. The reduction acts at once; the force returns as slowly as after a start.
  cool_ = std::min(1.0, cool_ + dt / kEngage);
  const auto unit = [&](std::size_t i) {
    return std::abs(profile_.output->fields[*profile_.joints[i].to].scale);
  };
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    const double asked = share * std::abs(raw[i]);
    if (!(profile_.joints[i].continuous > 0.0) || !(asked > 0.0)) continue;
    const double along = raw[i] > 0.0 ? weight[i] : -weight[i];
    const double allowed = unit(i) * heat_[i].allows((room[i] + along) / unit(i)) - along;
    cool_ = std::min(cool_, std::max(allowed, 0.0) / asked);
  }
  share *= cool_;
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    if (profile_.joints[i].to) heat_[i].tell((share * raw[i] + weight[i]) / unit(i));
  }
  given_ = share;
  if (share < 1.0) ++weakened_;
  for (std::size_t i = 0; i < profile_.joints.size(); ++i) {
    if (!profile_.joints[i].to) continue;
    const ReportField& field = profile_.output->fields[*profile_.joints[i].to];
    // Rounds towards zero, so that rounding adds no force.
    const double wanted = share * raw[i] + weight[i];
    putRaw(report.subspan(1), field,
           field.type == ReportField::Type::kFloat ? wanted + field.offset
                                                   : std::round(field.offset) + std::trunc(wanted));
  }
}

void HidDevice::write(const Vec3& force) noexcept {
  if (!profile_.output) return;
  if (written_ == sent_) written_at_ = host_.now();
  const std::span<std::byte> report = std::span(out_.draft().bytes).first(zero_.size());
  encode(force, report);
  rests_.store(std::equal(report.begin(), report.end(), zero_.begin()), std::memory_order_relaxed);
  out_.publish();
  sent_.fetch_add(1, std::memory_order_release);
  sent_.notify_one();
}

void HidDevice::lost() noexcept {
  gone_ = true;
  mend_.notify_all();
}

void HidDevice::writeLoop() noexcept {
  RealtimeRequest request;
  request.lock_memory = false;
  request.awake = false;
  (void)becomeRealtime(request, StayAwake(false));
  // Uses the machine's clock. If the last report drove a motor, a report that drives no motor is
  // sent without waiting.
  Pace pace(profile_.output_rate, nowNs());
  bool drives = false;
  for (std::uint32_t seen = 0;;) {
    sent_.wait(seen, std::memory_order_acquire);
    while (!quit_ && !(drives && rests_) && nowNs() < pace.from()) {
      sleepUntil(std::min(pace.from(), nowNs() + kLongestSleep));
    }
    pace.go(nowNs());
    seen = sent_.load(std::memory_order_acquire);
    if (quit_) return;
    out_.refresh();
    // Checks the port, not gone_: after a miscount the device is still connected and must get zero
    // force.
    const Using port(open_port_, writing_);
    if (!port) continue;
    const std::int64_t began = host_.now();
    const auto report = std::span(out_.current().bytes).first(zero_.size());
    const bool good = port->write(report);
    drives = !std::equal(report.begin(), report.end(), zero_.begin());
    longest_ns_ = std::max<std::int64_t>(longest_ns_, host_.now() - began);
    ++count_;
    written_ = seen;
    if (!good) lost();
  }
}

}  // namespace palpate
