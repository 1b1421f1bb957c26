/// Private to devices: the work of a plug-in's process: the loop between a PluginLink and an arm.
#pragma once

#include <atomic>
#include <cstdint>

#include "palpate/devices/plugins/plugin_library.h"
#include "palpate/devices/plugins/plugin_link.h"
#include "palpate/engine/safety/limit_force.h"

namespace palpate {

/// Checks that a magnitude grows no faster than its slew. A tick may be late by WatchLimits::late
/// without a fault, so a late tick's growth may come at once.
class GrowthCheck {
 public:
  /// @param slew  Largest growth in a second, > 0.
  explicit GrowthCheck(double slew) noexcept : slew_(slew) {}

  /// Returns true if `size` may follow the last size, or zero, `dt` [s] later. RT: no allocation.
  [[nodiscard]] bool look(double size, double dt) noexcept;
  /// Sets the last size to zero.
  void forget() noexcept { *this = GrowthCheck(slew_); }

 private:
  static constexpr double kLate = 0.005;  ///< [s]: WatchLimits::late

  double slew_;
  double size_ = 0.0;            ///< The last size.
  double room_ = slew_ * kLate;  ///< Unused growth of earlier sizes.
};

/// Passes orders to an arm and returns its news, on a thread of its own. Takes the force off if
/// orders no longer come. Sends an order as soon as it has come. The arm is read kLead before the
/// program's next read, which is expected one period after its last read. So a position is as fresh
/// as if it had been read in the tick, and the tick never waits.
class PluginServer {
 public:
  static constexpr std::int64_t kLead = 100'000;  ///< [ns]
  static constexpr double kSilent = 0.015;  ///< Time without orders until the force is zero [s].

  /// @param period  Period of the readings while the program's own is not known [s].
  /// @param peak    The largest force that is passed on [N].
  /// @param slew    The largest growth of that force [N/s].
  PluginServer(PluginLink& link, const PluginDevice& device, double period, double peak,
               double slew) noexcept
      : link_(link),
        device_(device),
        peak_(peak),
        force_growth_(slew),
        period_(static_cast<std::int64_t>(1e9 * period)) {}

  /// Runs until end(). RT: as far as the plug-in is; waits.
  void loop() noexcept;
  /// Returns true after loop() has returned.
  [[nodiscard]] bool done() const noexcept { return done_; }
  /// Ends loop(). Any thread.
  void end() noexcept { ended_ = true; }
  /// The action that loop() needs.
  enum class Look : std::uint8_t {
    kTurns,  ///< No action: loop() runs.
    kStop,   ///< Call stop(): loop() has stood still for kSilent. Returned once.
    kEnd,    ///< End this process: loop() has stood still for kHung.
  };
  /// Checks loop(); call it every millisecond or so, on another thread. If loop() stands still
  /// while the calls come in time, the plug-in hangs: the program then reports `write`, and its
  /// force stays off. If the calls are late too, the machine was late, and the program reports
  /// `late`.
  [[nodiscard]] Look look(std::int64_t now) noexcept;
  static constexpr double kHung = 0.2;  ///< [s]
  /// Keeps the force at zero until the program sends an order of zero force. For any thread.
  void stop() noexcept;

 private:
  /// Passes the newest order to the arm, or zero force if the force is off.
  void give(std::int64_t now) noexcept;
  /// Returns false for an order that the program's last gate cannot have let through: the plug-in's
  /// own code lies between that gate and the arm. Call it once for each order.
  [[nodiscard]] bool isSound(const PluginOrder& order, std::int64_t now) noexcept;
  void read() noexcept;
  /// Takes the force off, on the haptic thread, after any order.
  void takeOff() noexcept;
  [[nodiscard]] std::int64_t nextReading(std::int64_t now) noexcept;

  PluginLink& link_;
  const PluginDevice& device_;
  double peak_;
  GrowthCheck force_growth_;                 ///< Checks the force [N].
  GrowthCheck carry_growth_{1.0 / kEngage};  ///< Checks PluginOrder::carry.
  std::atomic<std::int64_t> period_;
  std::atomic<bool> ended_{false};
  std::atomic<bool> done_{false};
  std::atomic<bool> stopped_{false};  ///< Orders are withheld until one is zero.
  std::atomic<bool> blamed_{false};   ///< The plug-in hung; its stop does not count as late.

  PluginOrder order_;
  PluginNews news_;
  std::uint32_t seen_ = 0;       ///< Last value of PluginLink::orders.
  bool drives_ = false;          ///< The last force given was not zero.
  std::int64_t ordered_at_ = 0;  ///< [ns]
  std::int64_t ticked_at_ = 0;   ///< Last value of PluginLink::ticked_at.

  // Used by look() only.
  static constexpr double kPunctual = 0.005;  ///< Longest pause between two punctual calls [s].
  std::uint64_t beat_ = 0;
  std::int64_t beat_at_ = 0;    ///< [ns]
  std::int64_t looked_at_ = 0;  ///< [ns]
  std::int64_t held_up_ = 0;    ///< Time since `beat_at_` between calls that were late [ns].
  bool hung_ = false;
};

/// Runs palpate-plugin: loads `file`, opens the arm of that serial number and serves it by the
/// descriptors of plugin_link.h. listPlugin() lists the arms instead (kPluginControl only). Both
/// return the process' exit status.
[[nodiscard]] int servePlugin(const std::filesystem::path& file, const std::string& serial);
/// @see servePlugin
[[nodiscard]] int listPlugin(const std::filesystem::path& file);

}  // namespace palpate
