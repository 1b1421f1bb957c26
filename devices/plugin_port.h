/// A plug-in's arm as PluginArm has it: in this process, or in one of its own.
#pragma once

#include <cstdint>
#include <string>

#include "palpate/devices/plugin.h"
#include "palpate/engine/device.h"

namespace palpate {

inline constexpr double kPluginSlew = 2000.0;  ///< palpate_plugin_facts::slew where it is 0 [N/s].

/// What is told to a plug-in's arm each tick.
struct PluginOrder {
  palpate_plugin_force force{sizeof(palpate_plugin_force), 0, {}, {}};  ///< As it is to be given.
  double carry = 0.0;        ///< The share of its weight that it carries.
  std::uint32_t number = 0;  ///< Counts orders.
  std::uint32_t zero = 0;    ///< Zero.
};

/// What has come of a plug-in's arm. As it was said: nothing of it is checked.
struct PluginNews {
  /// The last that was new.
  palpate_plugin_reading reading{sizeof(palpate_plugin_reading), 0, 0, {}, {}, {}, 0.0, {}, 0, 0};
  std::int32_t read = PALPATE_PLUGIN_NOTHING;  ///< What the last read came to,
  std::int32_t wrote = PALPATE_PLUGIN_OK;      ///< and the last write.
  std::uint32_t written = 0;                   ///< PluginOrder::number of that write.
  std::uint32_t withheld = 0;  ///< Counts orders with a force that were not given: it was stopped.
  double given = 1.0;          ///< By the heat extension.
};

/// An arm that is open and prepared. read() and write() are one thread's.
class PluginPort {
 public:
  PluginPort() = default;
  PluginPort(const PluginPort&) = delete;
  PluginPort& operator=(const PluginPort&) = delete;
  virtual ~PluginPort() = default;

  /// As the plug-in said, whole (sized); nothing of it is checked.
  [[nodiscard]] virtual const palpate_plugin_facts& facts() const noexcept = 0;
  [[nodiscard]] virtual std::string version() const = 0;  ///< Of the plug-in.
  /// Of the arm that was opened; empty: it has none.
  [[nodiscard]] virtual std::string serial() const = 0;
  /// The most of its weight that its motors carry [N], by the extension for it; 0: none. Not
  /// checked.
  [[nodiscard]] virtual double carries() const noexcept = 0;

  /// The newest; false, and `news` as it was: the arm is gone. RT: no allocation.
  [[nodiscard]] virtual bool read(PluginNews& news) noexcept PALPATE_NONBLOCKING = 0;
  /// Sends an order. RT: no allocation.
  virtual void write(const PluginOrder& order) noexcept PALPATE_NONBLOCKING = 0;
  /// For a guardian; none: nobody can reach the arm when this process is dead.
  [[nodiscard]] virtual ZeroForce zeroForce() const noexcept { return {}; }
  /// How often it has been opened, the first time included.
  [[nodiscard]] virtual std::uint32_t openings() const noexcept { return 1; }
};

}  // namespace palpate
