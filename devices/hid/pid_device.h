/// Private to devices: an arm of USB's PID class, such as a stick, a wheel or a yoke.
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/devices/arm/arm.h"
#include "palpate/devices/hid/hid_device.h"
#include "palpate/devices/hid/pid_descriptor.h"
#include "palpate/devices/hid/pid_port.h"

namespace palpate {

/// Reads and drives one to three axes of a PID device, by a HidDevice that uses a PidPort. The
/// device's own descriptor describes the reports. An effect lasts PidPort::duration(), so the force
/// ends by itself if the program ends. If duration() is 0, only a report ends the force.
///
/// Switched-off actuators and lost power are Fault::kPower; an open safety switch is
/// Fault::kSwitch. After the fault, the force grows from zero as at the start.
class PidDevice final : public Arm {
 public:
  /// Gain of an untested device that has a gain field, except during its test. It scales all
  /// forces.
  static constexpr double kUntestedGain = 0.1;
  /// Friction assumed for an arm without a measured friction [N s/m].
  static constexpr double kLikelyViscous = 0.5;

  /// Opens the device. Slow. Throws DeviceError with the problem in words. `profile` has axes in
  /// HidProfile::pid. A device that host.find returns must have the same descriptor. If not
  /// `tested`, the limits are at most kUntestedForce, kUntestedStiffness and kUntestedGain.
  PidDevice(const HidProfile& profile, std::span<const std::byte> descriptor,
            std::unique_ptr<ReportPort> port, bool tested, HidHost host = {});

  /// Returns the description, which never changes. DeviceInfo::output_rate is the profile's, or
  /// less if the device takes reports more slowly. max_stiffness is at most the passivity bound of
  /// docs/stability.md for the arm's delay.
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override;
  void write(const Vec3& force) noexcept override { arm_->write(force); }
  void carry(bool may) noexcept override { arm_->carry(may); }
  [[nodiscard]] double given() const noexcept override { return arm_->given(); }
  [[nodiscard]] ZeroForce zeroForce() const noexcept override;

  [[nodiscard]] const ArmTraits& traits() const noexcept override { return traits_; }
  [[nodiscard]] std::string whyNotReady() const override { return arm_->whyNotReady(); }
  [[nodiscard]] std::vector<double> steps() const override { return arm_->steps(); }
  [[nodiscard]] ArmTraffic traffic() const override { return arm_->traffic(); }

  [[nodiscard]] const HidProfile& profile() const noexcept { return arm_->profile(); }

 private:
  void describe(double duration, const MeasuredArm& measured, double gain);

  PidMap map_;
  PidState state_;
  std::uint32_t ever_ = 0;  ///< PidState::ever at the last reading.
  std::vector<std::byte> stop_;
  DeviceInfo info_;
  ArmTraits traits_;
  /// Destroyed before the other members, because it owns the port that refers to them.
  std::unique_ptr<HidDevice> arm_;
};

}  // namespace palpate
