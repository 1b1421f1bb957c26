/// Private to devices: the loop of a plug-in's process, between a PluginLink and an arm.
#pragma once

#include <atomic>
#include <cstdint>

#include "palpate/devices/plugins/plugin_library.h"
#include "palpate/devices/plugins/plugin_link.h"
#include "palpate/engine/safety/limit_force.h"

namespace palpate {

/// Checks that a magnitude grows no faster than its slew limit. A tick may come late by the default
/// of WatchLimits::late; the growth for this time is then accepted at once.
class GrowthCheck {
 public:
  /// @param slew  Largest growth per second, > 0.
  explicit GrowthCheck(double slew) noexcept : slew_(slew) {}

  /// Returns true if `size` may follow the previous size `dt` [s] later. RT: no allocation.
  [[nodiscard]] bool look(double size, double dt) noexcept;
  void forget() noexcept { *this = GrowthCheck(slew_); }

 private:
  static constexpr double kLate = 0.005;  ///< default of WatchLimits::late [s]

  double slew_;
  double size_ = 0.0;
  /// Growth that is permitted now, beyond `size_`.
  double room_ = slew_ * kLate;
};

/// Passes orders to an arm and publishes the arm's news, on the thread that calls loop(). Takes the
/// force off if no more orders come. Reads the arm shortly before the program's next expected
/// read (at most kLead), so the position is fresh and the tick does not wait.
class PluginServer {
 public:
  static constexpr std::int64_t kLead = 100'000;  ///< Largest lead of a reading [ns].
  /// Time without an order after which the force becomes zero [s].
  static constexpr double kSilent = 0.015;

  /// @param period  Period of the readings until the program's period is known [s].
  /// @param peak    Largest force that is passed on [N].
  /// @param slew    Largest growth of the force [N/s].
  PluginServer(PluginLink& link, const PluginDevice& device, double period, double peak,
               double slew) noexcept
      : link_(link),
        device_(device),
        peak_(peak),
        force_growth_(slew),
        period_(static_cast<std::int64_t>(1e9 * period)) {}

  /// Runs until end(). Waits between passes. RT, if the plug-in's functions are.
  void loop() noexcept;
  [[nodiscard]] bool done() const noexcept { return done_; }
  /// Ends loop(). Callable from any thread.
  void end() noexcept { ended_ = true; }
  /// The action that the state of loop() requires. The times below count from two periods after the
  /// last pass.
  enum class Look : std::uint8_t {
    kTurns,  ///< No action: loop() is running.
    kStop,   ///< Call stop(): loop() has made no pass for kSilent. Returned once.
    kEnd,    ///< End this process: loop() has made no pass for kHung.
  };
  /// Checks loop(). Call it about every millisecond, on another thread. If loop() makes no passes
  /// while these calls are punctual, the plug-in hangs: the program reports Fault::kWrite and its
  /// force stays off. If the calls are late too, the program reports Fault::kLate.
  [[nodiscard]] Look look(std::int64_t now) noexcept;
  static constexpr double kHung = 0.2;  ///< Time without a pass after which loop() hangs [s].
  /// Keeps the force at zero until an order of zero force comes. Callable from any thread.
  void stop() noexcept;

 private:
  void give(std::int64_t now) noexcept;
  /// Returns false for an order beyond the limits of the program's gate: the plug-in's code may
  /// have overwritten it. Call it once for each order.
  [[nodiscard]] bool isSound(const PluginOrder& order, std::int64_t now) noexcept;
  void read() noexcept;
  /// Sets force and carried weight to zero. Called on the haptic thread, so that no older order can
  /// follow.
  void takeOff() noexcept;
  [[nodiscard]] std::int64_t nextReading(std::int64_t now) noexcept;

  PluginLink& link_;
  const PluginDevice& device_;
  double peak_;
  GrowthCheck force_growth_;
  GrowthCheck carry_growth_{1.0 / kEngage};
  std::atomic<std::int64_t> period_;
  std::atomic<bool> ended_{false};
  std::atomic<bool> done_{false};
  /// Orders are withheld until a zero order comes.
  std::atomic<bool> stopped_{false};
  std::atomic<bool> blamed_{false};  ///< The plug-in hung.

  PluginOrder order_;
  PluginNews news_;
  std::uint32_t seen_ = 0;
  bool drives_ = false;          ///< The last force that was passed on was not zero.
  std::int64_t ordered_at_ = 0;  ///< Time of the last order [ns].
  std::int64_t ticked_at_ = 0;

  // Used by look() only.
  static constexpr double kPunctual = 0.005;  ///< Longest pause between two punctual calls [s].
  std::uint64_t beat_ = 0;
  std::int64_t beat_at_ = 0;    ///< Time of the last pass of loop() that look() saw [ns].
  std::int64_t looked_at_ = 0;  ///< Time of the last call of look() [ns].
  /// Time since `beat_at_` in which look() was called late [ns].
  std::int64_t held_up_ = 0;
  bool hung_ = false;
};

/// Runs palpate-plugin: opens an arm and serves it. Returns the exit status.
[[nodiscard]] int servePlugin(const std::filesystem::path& file, const std::string& serial);
/// Lists the arms through kPluginControl. Returns the exit status.
[[nodiscard]] int listPlugin(const std::filesystem::path& file);

}  // namespace palpate
