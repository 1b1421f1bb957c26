/// Private to devices: an arm that is a device of USB's PID class: a stick, a wheel, a yoke with
/// force feedback.
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/devices/arm.h"
#include "palpate/devices/hid_device.h"
#include "palpate/devices/pid_descriptor.h"
#include "palpate/devices/pid_port.h"

namespace palpate {

/// Reads and drives one to three axes of it: a HidDevice whose reports its own descriptor tells of,
/// behind a PidPort. An effect lasts PidPort::duration(), so that the device of a host that has
/// gone loses its force by itself.
///
/// Actuators that fall off and power that goes are Fault::kPower, a safety switch that opens
/// Fault::kSwitch. Where they come, or come back, a force comes in as at the beginning.
class PidDevice final : public Arm {
 public:
  /// As long as a device has not passed its test it gives so much of its full force, whatever it is
  /// told.
  static constexpr double kUntestedGain = 0.1;
  /// Friction that an arm is taken to have, at which it was not measured [N s/m].
  static constexpr double kLikelyViscous = 0.5;

  /// Slow. Throws DeviceError: what is wrong, in words.
  ///
  /// @param profile     With HidProfile::pid.
  /// @param descriptor  The device's own; a device that host.find finds again has the same.
  /// @param tested      It has passed `palpate devices --test`; else kUntestedForce,
  ///                    kUntestedStiffness and kUntestedGain hold.
  PidDevice(const HidProfile& profile, std::span<const std::byte> descriptor,
            std::unique_ptr<ReportPort> port, bool tested, HidHost host = {});

  /// DeviceInfo::output_rate by how long its reports take; max_stiffness by the passivity bound of
  /// docs/stability.md for that delay. Never changes.
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] HandState read() noexcept override;
  void write(const Vec3& force) noexcept override { arm_->write(force); }
  void carry(bool may) noexcept override { arm_->carry(may); }
  [[nodiscard]] double given() const noexcept override { return arm_->given(); }
  /// The report that stops all effects.
  [[nodiscard]] ZeroForce zeroForce() const noexcept override;

  [[nodiscard]] const ArmTraits& traits() const noexcept override { return traits_; }
  [[nodiscard]] std::string whyNotReady() const override { return arm_->whyNotReady(); }
  [[nodiscard]] std::vector<double> steps() const override { return arm_->steps(); }
  [[nodiscard]] ArmTraffic traffic() const override { return arm_->traffic(); }

  /// The profile with the fields of this device. As given else.
  [[nodiscard]] const HidProfile& profile() const noexcept { return arm_->profile(); }

 private:
  /// What its delay and rate leave of a coupling, in words too.
  void describe(double duration, const MeasuredArm& measured, double gain);

  PidMap map_;
  PidState state_;
  std::uint32_t ever_ = 0;  ///< Of its state, at the last reading.
  std::vector<std::byte> stop_;
  DeviceInfo info_;
  ArmTraits traits_;
  std::unique_ptr<HidDevice> arm_;  ///< Goes first: it has the port.
};

}  // namespace palpate
