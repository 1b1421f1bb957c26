/// An arm that a plug-in drives, in this process or in the plug-in's own process. Checks the values
/// of the plug-in; the loop checks the position.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "palpate/devices/arm/arm.h"
#include "palpate/devices/plugins/plugin_port.h"

namespace palpate {

/// Returns the description of an arm from its plug-in's facts. `tested`: the arm has passed its
/// test. Throws DeviceError for an invalid or missing number, because an arm without limits must
/// not get a force.
[[nodiscard]] DeviceInfo infoFor(const palpate_plugin_facts& facts, const std::string& name,
                                 bool tested);
/// Returns the key under which the arm's test is stored.
///
/// @param carries  PluginPort::carries.
/// @param name     `plugin:NAME`.
/// @param serial   Empty: the arm has no serial number.
[[nodiscard]] ArmIdentity identityOf(const palpate_plugin_facts& facts, double carries,
                                     const std::string& name, const std::string& version,
                                     const std::string& serial);

/// Reads and drives an arm through a PluginPort.
///
/// The age of a position counts from its measurement, at the latest from the read that first saw
/// it. So an arm whose position keeps its time becomes stale (WatchLimits::stale). If the plug-in
/// gives new times to an unchanged position, the force fades (StillFade).
///
/// Faults:
/// - Fault::kWrite: the plug-in did not take a force within 20 ms plus a period, or a write has
///   failed, or the plug-in's process has refused an order that violates the gate's limits.
/// - Fault::kGone: the plug-in has ended, or the arm is unplugged.
/// - Fault::kLate: the plug-in's process has taken the force off because orders came late, or
///   because a guardian stopped it.
/// - Fault::kTemperature, kPower, kSwitch: the plug-in reports this state.
///
/// The loop reports a position that is not finite (Fault::kNotFinite).
class PluginArm final : public Arm {
 public:
  /// Throws DeviceError if the facts are not usable (infoFor).
  PluginArm(std::unique_ptr<PluginPort> port, const std::string& name, bool tested,
            const ArmHost& host = {});
  /// Writes zero force, then closes the port.
  ~PluginArm() override;

  [[nodiscard]] const DeviceInfo& info() const noexcept override { return info_; }
  [[nodiscard]] const ArmTraits& traits() const noexcept override { return traits_; }
  [[nodiscard]] HandState read() noexcept override;
  void write(const Vec3& force) noexcept override;
  void carry(bool may) noexcept override;
  [[nodiscard]] double given() const noexcept override { return given_; }
  [[nodiscard]] ZeroForce zeroForce() const noexcept override { return port_->zeroForce(); }
  [[nodiscard]] std::string whyNotReady() const override;
  [[nodiscard]] std::vector<double> steps() const override;
  [[nodiscard]] ArmTraffic traffic() const override;

 private:
  static constexpr std::int64_t kNever = -1;
  void take(std::int64_t now, HandState& hand) noexcept;
  [[nodiscard]] bool has(std::uint32_t flag) const noexcept { return (facts_.has & flag) != 0; }

  std::unique_ptr<PluginPort> port_;
  palpate_plugin_facts facts_;
  DeviceInfo info_;
  ArmTraits traits_;
  std::int64_t (*now_)() noexcept;

  PluginNews news_;
  HandState hand_;
  std::int64_t taken_ = 0;          ///< palpate_plugin_reading::taken of the last new position.
  std::int64_t heard_at_ = kNever;  ///< Time from which the position's age counts [ns].
  std::int64_t moved_at_ = 0;       ///< Time of the last change of position [ns].
  std::int64_t read_at_ = 0;
  std::uint32_t opening_ = 1;
  PluginOrder order_;
  std::uint32_t written_seen_ = 0;
  /// Time since which `written_seen_` is constant while orders wait [ns].
  std::int64_t written_at_ = 0;
  std::uint32_t withheld_seen_ = 0;
  /// Longest time from an order to its write by the plug-in [ns].
  std::int64_t longest_ = 0;
  std::int64_t writes_ = 0;
  double given_ = 1.0;
  double most_carried_ = 0.0;
  bool carries_ = false;  ///< carry() permits the motors to carry the weight.
  bool upright_ = false;  ///< The last reading permits the motors to carry the weight.
};

}  // namespace palpate
