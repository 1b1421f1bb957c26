/// The interface of a plug-in's arm, in this process or in the plug-in's own process.
#pragma once

#include <cstdint>
#include <string>

#include "palpate/devices/plugins/plugin.h"
#include "palpate/engine/safety/device.h"

namespace palpate {

/// Largest growth of the force if palpate_plugin_facts::slew is 0 [N/s].
inline constexpr double kPluginSlew = 2000.0;

/// An order to a plug-in's arm, one per tick.
struct PluginOrder {
  palpate_plugin_force force{sizeof(palpate_plugin_force), 0, {}, {}};  ///< Force on the hand.
  double carry = 0.0;        ///< Share of the arm's weight that the motors carry, 0 to 1.
  std::uint32_t number = 0;  ///< Sequence number.
  std::uint32_t zero = 0;    ///< Always zero.
};

/// State of a plug-in's arm as the plug-in reported it, not yet checked.
struct PluginNews {
  /// The newest reading.
  palpate_plugin_reading reading{sizeof(palpate_plugin_reading), 0, 0, {}, {}, {}, 0.0, {}, 0, 0};
  std::int32_t read = PALPATE_PLUGIN_NOTHING;  ///< Result of the last read.
  std::int32_t wrote = PALPATE_PLUGIN_OK;      ///< Result of the last write.
  std::uint32_t written = 0;                   ///< PluginOrder::number of the last write.
  /// Number of orders with a force that were not passed on because of a stop.
  std::uint32_t withheld = 0;
  /// Share of the last force that the motors have given, by the heat extension; 0 if the force was
  /// withheld.
  double given = 1.0;
};

/// An arm that is open and prepared. Call read() and write() on one thread.
class PluginPort {
 public:
  PluginPort() = default;
  PluginPort(const PluginPort&) = delete;
  PluginPort& operator=(const PluginPort&) = delete;
  virtual ~PluginPort() = default;

  /// Returns the facts as the plug-in reported them, not yet checked. Missing fields are zero.
  [[nodiscard]] virtual const palpate_plugin_facts& facts() const noexcept = 0;
  [[nodiscard]] virtual std::string version() const = 0;  ///< Returns the version of the plug-in.
  /// Returns the serial number of the open arm; may be empty.
  [[nodiscard]] virtual std::string serial() const = 0;
  /// Returns the largest weight that the arm's motors can carry [N], by the weight extension; 0:
  /// they carry no weight. Not yet checked.
  [[nodiscard]] virtual double carries() const noexcept = 0;

  /// Reads the arm's newest state. Returns false, and leaves `news` unchanged, if the plug-in's
  /// process has ended. RT: no allocation.
  [[nodiscard]] virtual bool read(PluginNews& news) noexcept PALPATE_NONBLOCKING = 0;
  /// Sends an order to the arm. RT: no allocation.
  virtual void write(const PluginOrder& order) noexcept PALPATE_NONBLOCKING = 0;
  /// Returns the zero force for a guardian; empty if another process cannot reach the arm.
  [[nodiscard]] virtual ZeroForce zeroForce() const noexcept { return {}; }
  /// Returns how often the arm has been opened, including the first time.
  [[nodiscard]] virtual std::uint32_t openings() const noexcept { return 1; }
};

}  // namespace palpate
