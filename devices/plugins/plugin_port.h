/// The interface of PluginArm to a plug-in's arm, in this process or in a process of its own.
#pragma once

#include <cstdint>
#include <string>

#include "palpate/devices/plugins/plugin.h"
#include "palpate/engine/safety/device.h"

namespace palpate {

inline constexpr double kPluginSlew = 2000.0;  ///< Slew if palpate_plugin_facts::slew is 0 [N/s].

/// An order to a plug-in's arm, one per tick.
struct PluginOrder {
  palpate_plugin_force force{sizeof(palpate_plugin_force), 0, {}, {}};  ///< Force to give.
  double carry = 0.0;        ///< Share of the arm's weight to carry.
  std::uint32_t number = 0;  ///< Counts orders.
  std::uint32_t zero = 0;    ///< Zero.
};

/// News of a plug-in's arm, as the plug-in reported it, unchecked.
struct PluginNews {
  /// The last new reading.
  palpate_plugin_reading reading{sizeof(palpate_plugin_reading), 0, 0, {}, {}, {}, 0.0, {}, 0, 0};
  std::int32_t read = PALPATE_PLUGIN_NOTHING;  ///< Result of the last read.
  std::int32_t wrote = PALPATE_PLUGIN_OK;      ///< Result of the last write.
  std::uint32_t written = 0;                   ///< PluginOrder::number of that write.
  std::uint32_t withheld = 0;  ///< Counts orders with a force that were withheld after a stop.
  double given = 1.0;          ///< Share of the force that was given, by the heat extension.
};

/// An arm that is open and prepared. Call read() and write() on one thread.
class PluginPort {
 public:
  PluginPort() = default;
  PluginPort(const PluginPort&) = delete;
  PluginPort& operator=(const PluginPort&) = delete;
  virtual ~PluginPort() = default;

  /// Returns the facts as the plug-in reported them, in full size, unchecked.
  [[nodiscard]] virtual const palpate_plugin_facts& facts() const noexcept = 0;
  [[nodiscard]] virtual std::string version() const = 0;  ///< Version of the plug-in.
  /// Returns the serial number of the open arm; empty: it has no number.
  [[nodiscard]] virtual std::string serial() const = 0;
  /// Returns the largest weight that the arm's motors carry [N], by the extension for weight; 0:
  /// they carry no weight. Unchecked.
  [[nodiscard]] virtual double carries() const noexcept = 0;

  /// Reads the newest news. Returns false, with `news` as it was, if the arm is gone. RT: no
  /// allocation.
  [[nodiscard]] virtual bool read(PluginNews& news) noexcept PALPATE_NONBLOCKING = 0;
  /// Sends an order. RT: no allocation.
  virtual void write(const PluginOrder& order) noexcept PALPATE_NONBLOCKING = 0;
  /// Returns the zero force for a guardian; empty: no process can reach the arm when this one is
  /// dead.
  [[nodiscard]] virtual ZeroForce zeroForce() const noexcept { return {}; }
  /// Returns how often the arm has been opened, the first time included.
  [[nodiscard]] virtual std::uint32_t openings() const noexcept { return 1; }
};

}  // namespace palpate
