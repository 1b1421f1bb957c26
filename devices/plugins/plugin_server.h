/// Private to devices: the work of a plug-in's process: the loop between a PluginLink and an arm.
#pragma once

#include <atomic>
#include <cstdint>

#include "palpate/devices/plugins/plugin_library.h"
#include "palpate/devices/plugins/plugin_link.h"
#include "palpate/engine/safety/limit_force.h"

namespace palpate {

/// Checks that a magnitude grows no faster than its slew limit. A tick may be late by
/// WatchLimits::late without a fault, so the growth of a late tick may come at once.
class GrowthCheck {
 public:
  /// @param slew  Largest growth per second, > 0.
  explicit GrowthCheck(double slew) noexcept : slew_(slew) {}

  /// Returns true if `size` may follow the previous size `dt` [s] later; before the first call that
  /// size is zero. RT: no allocation.
  [[nodiscard]] bool look(double size, double dt) noexcept;
  /// Forgets the previous size and sets it to zero.
  void forget() noexcept { *this = GrowthCheck(slew_); }

 private:
  static constexpr double kLate = 0.005;  ///< [s], as WatchLimits::late

  double slew_;
  double size_ = 0.0;  ///< Size in the previous call.
  /// Growth that is allowed now: what earlier calls have left unused.
  double room_ = slew_ * kLate;
};

/// Passes orders to an arm and returns its news, on its own thread. Takes the force off if no more
/// orders come. Sends an order as soon as it has come. Reads the arm kLead before the program's
/// next read is expected, one period after its last. So the position is as fresh as if the tick had
/// read the arm itself, and the tick never waits.
class PluginServer {
 public:
  static constexpr std::int64_t kLead = 100'000;  ///< [ns]
  /// Longest time without an order before the force becomes zero [s].
  static constexpr double kSilent = 0.015;

  /// @param period  Period of the readings until the program's period is known [s].
  /// @param peak    Largest force that is passed on [N].
  /// @param slew    Largest growth of that force [N/s].
  PluginServer(PluginLink& link, const PluginDevice& device, double period, double peak,
               double slew) noexcept
      : link_(link),
        device_(device),
        peak_(peak),
        force_growth_(slew),
        period_(static_cast<std::int64_t>(1e9 * period)) {}

  /// Runs until end(). Waits between turns. RT, if the plug-in's functions are.
  void loop() noexcept;
  /// Returns true after loop() has returned.
  [[nodiscard]] bool done() const noexcept { return done_; }
  /// Ends loop(). Callable from any thread.
  void end() noexcept { ended_ = true; }
  /// The action that the state of loop() requires.
  enum class Look : std::uint8_t {
    kTurns,  ///< No action: loop() is running.
    kStop,   ///< Call stop(), because loop() has made no turn for kSilent. Returned once.
    kEnd,    ///< End this process, because loop() has made no turn for kHung.
  };
  /// Checks loop(). Call it about every millisecond, on another thread. If loop() makes no turns
  /// while these calls come in time, the plug-in hangs: the program then reports Fault::kWrite and
  /// its force stays off. If the calls are late too, the machine was late, and the program reports
  /// Fault::kLate.
  [[nodiscard]] Look look(std::int64_t now) noexcept;
  static constexpr double kHung = 0.2;  ///< [s]
  /// Keeps the force at zero until the program sends an order of zero force. Callable from any
  /// thread.
  void stop() noexcept;

 private:
  /// Passes the newest order to the arm; if the force is off, passes zero force.
  void give(std::int64_t now) noexcept;
  /// Returns false for an order that the program's last gate cannot have let through. The plug-in's
  /// own code runs between that gate and the arm, and may have changed the order. Call it once for
  /// each order.
  [[nodiscard]] bool isSound(const PluginOrder& order, std::int64_t now) noexcept;
  void read() noexcept;
  /// Removes gravity compensation and force, and stops the device. Called on the haptic thread, so
  /// it comes after any order in progress.
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
  /// Orders are not passed on until the program sends a zero order.
  std::atomic<bool> stopped_{false};
  std::atomic<bool> blamed_{false};  ///< The plug-in hung, so its stop is not reported as late.

  PluginOrder order_;
  PluginNews news_;
  std::uint32_t seen_ = 0;       ///< Last value of PluginLink::orders.
  bool drives_ = false;          ///< The last force that was passed on was not zero.
  std::int64_t ordered_at_ = 0;  ///< [ns]
  std::int64_t ticked_at_ = 0;   ///< Last value of PluginLink::ticked_at.

  // Used by look() only.
  static constexpr double kPunctual = 0.005;  ///< Longest pause between two punctual calls [s].
  std::uint64_t beat_ = 0;
  std::int64_t beat_at_ = 0;    ///< [ns]
  std::int64_t looked_at_ = 0;  ///< [ns]
  /// Time since `beat_at_` during which calls of look() were late [ns].
  std::int64_t held_up_ = 0;
  bool hung_ = false;
};

/// Runs palpate-plugin: loads `file`, opens the arm with this serial number and serves it through
/// the descriptors of plugin_link.h. listPlugin() lists the arms instead (kPluginControl only).
/// Both return the process' exit status.
[[nodiscard]] int servePlugin(const std::filesystem::path& file, const std::string& serial);
/// @see servePlugin
[[nodiscard]] int listPlugin(const std::filesystem::path& file);

}  // namespace palpate
