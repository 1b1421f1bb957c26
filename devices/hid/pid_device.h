/// Private to devices: an arm that is a device of USB's PID class, such as a stick, a wheel or a
/// yoke with force feedback.
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

/// Reads and drives one to three axes of a PID device. It is a HidDevice behind a PidPort; the
/// device's own descriptor gives the reports. An effect lasts PidPort::duration(): the force ends
/// by itself if the host is gone. If duration() is 0, only a report ends the force.
///
/// Actuators that are switched off and lost power are Fault::kPower; an open safety switch is
/// Fault::kSwitch. If actuators or power return, or the switch closes, the force grows from zero as
/// at the start.
class PidDevice final : public Arm {
 public:
  /// Gain of an untested device, if it has a gain field: scales every force that is sent.
  static constexpr double kUntestedGain = 0.1;
  /// Friction assumed for an arm that was not measured [N s/m].
  static constexpr double kLikelyViscous = 0.5;

  /// Slow. Throws DeviceError with the problem in words.
  ///
  /// @param profile     With HidProfile::pid.
  /// @param descriptor  The device's own; a device that host.find returns has the same.
  /// @param tested      The arm has passed `palpate devices --test`; else kUntestedForce,
  ///                    kUntestedStiffness and kUntestedGain hold.
  PidDevice(const HidProfile& profile, std::span<const std::byte> descriptor,
            std::unique_ptr<ReportPort> port, bool tested, HidHost host = {});

  /// DeviceInfo::output_rate follows from the time that its reports take. max_stiffness is the
  /// passivity bound of docs/stability.md for that delay. Never changes.
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override;
  void write(const Vec3& force) noexcept override { arm_->write(force); }
  void carry(bool may) noexcept override { arm_->carry(may); }
  [[nodiscard]] double given() const noexcept override { return arm_->given(); }
  /// Returns the report that stops all effects.
  [[nodiscard]] ZeroForce zeroForce() const noexcept override;

  [[nodiscard]] const ArmTraits& traits() const noexcept override { return traits_; }
  [[nodiscard]] std::string whyNotReady() const override { return arm_->whyNotReady(); }
  [[nodiscard]] std::vector<double> steps() const override { return arm_->steps(); }
  [[nodiscard]] ArmTraffic traffic() const override { return arm_->traffic(); }

  /// Returns the profile with the fields of this device; the rest is as given.
  [[nodiscard]] const HidProfile& profile() const noexcept { return arm_->profile(); }

 private:
  /// Sets the coupling limits that its delay and rate permit, and describes them in words.
  void describe(double duration, const MeasuredArm& measured, double gain);

  PidMap map_;
  PidState state_;
  std::uint32_t ever_ = 0;  ///< Copy of state_.ever at the last reading.
  std::vector<std::byte> stop_;
  DeviceInfo info_;
  ArmTraits traits_;
  std::unique_ptr<HidDevice> arm_;  ///< Destroyed first, because it has the port.
};

}  // namespace palpate
