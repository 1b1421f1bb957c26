#include "palpate/devices/hid/pid_device.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "palpate/devices/simulated/stability.h"
#include "palpate/engine/error.h"

namespace palpate {

namespace {

std::string text(double value) {
  std::array<char, 32> out{};
  std::snprintf(out.data(), out.size(), "%.3g", value);
  return out.data();
}

PidMap mapOf(const HidProfile& profile, std::span<const std::byte> descriptor) {
  const std::string name = "arm " + profile.name;
  const auto device = parseHidDescriptor(descriptor);
  if (!device) {
    const bool absent = descriptor.empty();
    throw DeviceError(
        name, absent ? "its report descriptor cannot be read" : "its report descriptor is invalid",
        absent ? "make /sys/class/hidraw readable (in a container, mount /sys)"
               : "update the device's firmware");
  }
  return readPidMap(*device, name);
}

}  // namespace

PidDevice::PidDevice(const HidProfile& profile, std::span<const std::byte> descriptor,
                     std::unique_ptr<ReportPort> port, bool tested, HidHost host)
    : map_(mapOf(profile, descriptor)), stop_(stoppingReport(map_)) {
  if (stop_.size() > ZeroForce::kMostBytes) stop_.clear();
  PidParams params;
  params.name = "arm " + profile.name;
  for (const PidAxisSpec& axis : profile.pid) params.axes.push_back(axis.axis);
  const bool has_gain = map_.gain && map_.gain->find(pid::kDeviceGain) != nullptr;
  // A smaller gain does not enlarge the magnitudes, so firmware that ignores the gain gives the
  // computed forces, not larger ones.
  params.gain = tested || host.tests || !has_gain ? 1.0 : kUntestedGain;
  params.now = host.now;
  HidProfile described = describedBy(map_, profile);
  auto driven = std::make_unique<PidPort>(map_, params, std::move(port), state_);
  PidPort* const opened = driven.get();

  const double reports = opened->writeTime() * static_cast<double>(params.axes.size());
  if (reports > 0.0) described.output_rate = std::min(described.output_rate, 1.0 / reports);
  if (host.find) {
    host.find = [this, params, find = host.find]() -> std::unique_ptr<ReportPort> {
      std::unique_ptr<ReportPort> again = find();
      if (again == nullptr) return nullptr;
      return std::make_unique<PidPort>(map_, params, std::move(again), state_);
    };
  }
  const double duration = opened->duration();
  const MeasuredArm measured = host.measured;
  arm_ =
      std::make_unique<HidDevice>(std::move(described), std::move(driven), tested, std::move(host));
  describe(duration, measured, params.gain);
}

void PidDevice::describe(double duration, const MeasuredArm& measured, double gain) {
  const HidProfile& profile = arm_->profile();
  info_ = arm_->info();
  traits_ = arm_->traits();
  for (const PidAxisSpec& axis : profile.pid) {
    info_.limits.peak = std::min(info_.limits.peak, std::abs(axis.force));
  }
  // A position may be one input period old; the last axis gets its report an output period later.
  const double period = 1.0 / info_.output_rate;
  double delay = 1.0 / profile.input_rate + period;
  if (measured.viscous > 0.0) delay = measured.delay + measured.doubt;
  ArmParams known;
  known.viscous = measured.viscous > 0.0 ? measured.viscous : kLikelyViscous;
  known.delay = delay;
  // The coupling's damping uses a part of the friction that passivity needs.
  info_.max_damping = std::min(info_.max_damping, 0.5 * known.viscous);
  const double most = passiveStiffness(known, info_.output_rate, info_.max_damping);
  info_.max_stiffness = std::min(info_.max_stiffness, most);
  traits_.stiffness = std::min(traits_.stiffness, most);
  info_.source += "; at most " + text(most) + " N/m, from " + text(info_.output_rate) +
                  " forces per second, a delay of " + text(1e3 * delay) + " ms and a " +
                  (measured.viscous > 0.0 ? "measured" : "guessed") + " friction of " +
                  text(known.viscous) + " N s/m (docs/stability.md)";
  if (gain < 1.0) info_.source += "; untested: its gain is reduced to a tenth";
  info_.source += duration > 0.0
                      ? "; if the program ends without stopping the arm, the force ends within " +
                            text(duration) + " s"
                      : "; if the program ends without stopping the arm, the force stays on, "
                        "because the arm's effects have no duration";
  if (stop_.empty()) {
    info_.source += "; it has no guardian, because no single report stops its force";
  }
  for (std::size_t i = 0; i < map_.buttons.size(); ++i) {
    info_.handle.buttons.push_back("button " + std::to_string(i + 1));
  }
}

HandState PidDevice::read() noexcept {
  HandState hand = arm_->read();
  hand.handle.buttons = state_.buttons;
  const std::uint32_t ever = state_.ever;
  if ((ever & ~ever_) != 0) hand.ready = false;
  ever_ = ever;
  if (hand.fault != Fault::kNone) return hand;
  const std::uint32_t fallen = state_.fallen();
  if ((fallen & PidState::kSafety) != 0) {
    hand.fault = Fault::kSwitch;
  } else if (fallen != 0) {
    hand.fault = Fault::kPower;
  }
  return hand;
}

ZeroForce PidDevice::zeroForce() const noexcept {
  if (stop_.empty()) return {};
  ZeroForce zero = arm_->zeroForce();
  zero.bytes = stop_;
  return zero;
}

}  // namespace palpate
