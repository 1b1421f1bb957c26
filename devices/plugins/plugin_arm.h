/// An arm that a plug-in drives. PluginArm checks all values from the plug-in, in whichever process
/// the plug-in runs.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "palpate/devices/arm/arm.h"
#include "palpate/devices/plugins/plugin_port.h"

namespace palpate {

/// Returns the description of an arm, from its plug-in's facts and from whether it has passed its
/// test. Throws DeviceError with the number that is invalid or missing: without limits no force is
/// given.
[[nodiscard]] DeviceInfo infoFor(const palpate_plugin_facts& facts, const std::string& name,
                                 bool tested);
/// Returns the identity under which the arm's test is stored. `carries`: PluginPort::carries;
/// `name`: plugin:NAME; `serial`: empty if the arm has no serial number.
[[nodiscard]] ArmIdentity identityOf(const palpate_plugin_facts& facts, double carries,
                                     const std::string& name, const std::string& version,
                                     const std::string& serial);

/// Reads and drives an arm over a PluginPort.
///
/// The age of a position counts from its measurement, and at the latest from when PluginArm first
/// saw it. So an arm with a dead sensor becomes stale (WatchLimits::stale), even if its plug-in
/// reports a new time. If the same position keeps coming as new, the force fades (StillFade).
///
/// Faults: a write that is not taken for 20 ms beyond a period is Fault::kWrite. A plug-in that has
/// ended, or an unplugged arm, is Fault::kGone. Numbers that are not finite are Fault::kNotFinite.
/// If the plug-in's process has taken the force off because no order came for a while, the fault is
/// Fault::kLate. If the process has refused an order that no gate can have let through, the fault
/// is Fault::kWrite.
class PluginArm final : public Arm {
 public:
  /// Throws DeviceError if the facts are not usable (infoFor).
  PluginArm(std::unique_ptr<PluginPort> port, const std::string& name, bool tested,
            const ArmHost& host = {});
  /// Writes zero force first.
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
  /// Takes the new and valid parts of the news.
  void take(std::int64_t now, HandState& hand) noexcept;
  [[nodiscard]] bool has(std::uint32_t flag) const noexcept { return (facts_.has & flag) != 0; }

  std::unique_ptr<PluginPort> port_;
  palpate_plugin_facts facts_;
  DeviceInfo info_;
  ArmTraits traits_;
  std::int64_t (*now_)() noexcept;

  PluginNews news_;
  HandState hand_;                  ///< The last reading.
  std::int64_t taken_ = 0;          ///< palpate_plugin_reading::taken of the last new position.
  std::int64_t heard_at_ = kNever;  ///< Time from which its age counts [ns].
  std::int64_t moved_at_ = 0;       ///< Time of the last change of position [ns].
  std::int64_t read_at_ = 0;        ///< [ns]
  std::uint32_t opening_ = 1;       ///< Last value of PluginPort::openings.
  PluginOrder order_;
  std::uint32_t written_seen_ = 0;   ///< Last value of PluginNews::written.
  std::int64_t written_at_ = 0;      ///< Time from which it is unchanged while orders wait [ns].
  std::uint32_t withheld_seen_ = 0;  ///< Last value of PluginNews::withheld.
  std::int64_t longest_ = 0;         ///< Longest time from an order until it was written [ns].
  std::int64_t writes_ = 0;
  double given_ = 1.0;
  double most_carried_ = 0.0;  ///< Largest share of the weight that is carried.
  bool carries_ = false;       ///< carry() permits carrying the weight.
  bool upright_ = false;       ///< The last reading permits carrying the weight.
};

}  // namespace palpate
