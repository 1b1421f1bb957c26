/// An arm that a plug-in drives: all that it says is checked here, wherever the plug-in runs.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "palpate/devices/arm.h"
#include "palpate/devices/plugin_port.h"

namespace palpate {

/// What an arm is, by what its plug-in says and whether it has passed its test. Throws DeviceError:
/// which number is none, or is missing: without limits no force is given.
[[nodiscard]] DeviceInfo infoFor(const palpate_plugin_facts& facts, const std::string& name,
                                 bool tested);
/// By what its test is remembered. `carries`: PluginPort::carries; `name`: plugin:NAME; `serial`:
/// empty where it has none.
[[nodiscard]] ArmIdentity identityOf(const palpate_plugin_facts& facts, double carries,
                                     const std::string& name, const std::string& version,
                                     const std::string& serial);

/// Reads and drives an arm over a PluginPort.
///
/// A position counts from when it was measured, and at the latest from when it was first seen: an
/// arm whose sensor has died grows stale (WatchLimits::stale) whatever its plug-in says of the
/// time, and where the same position comes as new for ever the force fades (StillFade). A write
/// that is not taken for 20 ms beyond a period is Fault::kWrite, a plug-in that has ended, or whose
/// arm is unplugged, Fault::kGone; numbers that are not finite are Fault::kNotFinite. Where its
/// process has taken the force off, having had no order for a while, it is Fault::kLate; where it
/// has refused an order that no gate can have let through, Fault::kWrite.
class PluginArm final : public Arm {
 public:
  /// Throws DeviceError where its facts will not do (infoFor).
  PluginArm(std::unique_ptr<PluginPort> port, const std::string& name, bool tested,
            const ArmHost& host = {});
  /// Zero force first.
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
  /// What is new and whole of what has come.
  void take(std::int64_t now, HandState& hand) noexcept;
  [[nodiscard]] bool has(std::uint32_t flag) const noexcept { return (facts_.has & flag) != 0; }

  std::unique_ptr<PluginPort> port_;
  palpate_plugin_facts facts_;
  DeviceInfo info_;
  ArmTraits traits_;
  std::int64_t (*now_)() noexcept;

  PluginNews news_;
  HandState hand_;                  ///< As it was read last.
  std::int64_t taken_ = 0;          ///< palpate_plugin_reading::taken of the last new position,
  std::int64_t heard_at_ = kNever;  ///< and since when its age is counted [ns].
  std::int64_t moved_at_ = 0;       ///< [ns], the last position that was another one.
  std::int64_t read_at_ = 0;        ///< [ns]
  std::uint32_t opening_ = 1;       ///< PluginPort::openings.
  PluginOrder order_;
  std::uint32_t written_seen_ = 0;   ///< PluginNews::written,
  std::int64_t written_at_ = 0;      ///< and since when it is that while more is sent [ns].
  std::uint32_t withheld_seen_ = 0;  ///< PluginNews::withheld.
  std::int64_t longest_ = 0;         ///< [ns], from an order until it was seen to be written.
  std::int64_t writes_ = 0;
  double given_ = 1.0;
  double most_carried_ = 0.0;  ///< Largest share of its weight that it carries.
  bool carries_ = false;       ///< carry() has allowed it,
  bool upright_ = false;       ///< and so has the last reading.
};

}  // namespace palpate
