/// Private to devices: a plug-in's process, without its processes: what turns between a PluginLink
/// and an arm.
#pragma once

#include <atomic>
#include <cstdint>

#include "palpate/devices/plugin_library.h"
#include "palpate/devices/plugin_link.h"

namespace palpate {

/// Hands orders to an arm and its news back, on a thread of its own, and takes the force off where
/// nobody gives orders any more. What it does at the arm it does when there is something to do: an
/// order goes out as soon as it has come, and the arm is read kLead before the program is expected
/// to look, which is a period after it looked last; so a position is as fresh as if it had been
/// read in the tick, and the tick waits for nobody.
class PluginServer {
 public:
  static constexpr std::int64_t kLead = 100'000;  ///< [ns]
  static constexpr double kSilent = 0.015;  ///< Zero force where no order has come for so long [s].

  /// @param period  Between readings, where the program's own is not known [s].
  /// @param peak    The largest force that is handed on [N].
  /// @param slew    And how fast it may grow [N/s].
  PluginServer(PluginLink& link, const PluginDevice& device, double period, double peak,
               double slew) noexcept
      : link_(link),
        device_(device),
        peak_(peak),
        slew_(slew),
        period_(static_cast<std::int64_t>(1e9 * period)) {}

  /// Turns until end(). RT: as the plug-in is; a wait.
  void loop() noexcept;
  /// loop() has come back.
  [[nodiscard]] bool done() const noexcept { return done_; }
  /// Ends loop(). Any thread.
  void end() noexcept { ended_ = true; }
  /// What is to be done about loop().
  enum class Look : std::uint8_t {
    kTurns,  ///< Nothing.
    kStop,   ///< stop(): it has stood still in the plug-in for kSilent. Said once.
    kEnd,    ///< For kHung: this process is to end.
  };
  /// Looks after loop(), every millisecond or so, on another thread.
  [[nodiscard]] Look look(std::int64_t now) noexcept;
  static constexpr double kHung = 0.2;  ///< [s]
  /// Zero force, and none until the program has asked for zero. Any thread.
  void stop() noexcept;

 private:
  /// The newest order to the arm, or zero force where that is what there is to give.
  void give(std::int64_t now) noexcept;
  /// False of an order that the program's last gate cannot have let through: between it and the arm
  /// is the plug-in's own code. To be called once for each order.
  [[nodiscard]] bool isSound(const PluginOrder& order, std::int64_t now) noexcept;
  void read() noexcept;
  /// On the haptic thread, whatever it has just given.
  void takeOff() noexcept;
  [[nodiscard]] std::int64_t nextReading(std::int64_t now) noexcept;

  PluginLink& link_;
  const PluginDevice& device_;
  double peak_;
  double slew_;
  std::atomic<std::int64_t> period_;
  std::atomic<bool> ended_{false};
  std::atomic<bool> done_{false};
  std::atomic<bool> stopped_{false};  ///< Orders are not given until one is zero.

  PluginOrder order_;
  PluginNews news_;
  std::uint32_t seen_ = 0;       ///< PluginLink::orders.
  bool drives_ = false;          ///< The last force given was not zero.
  std::int64_t ordered_at_ = 0;  ///< [ns]
  double size_ = 0.0;            ///< Size of the last order's force [N].
  double room_ = 0.0;            ///< Growth that earlier orders have left over [N].
  std::int64_t ticked_at_ = 0;   ///< PluginLink::ticked_at.

  // look()'s.
  std::uint64_t beat_ = 0;
  std::int64_t beat_at_ = 0;
  bool hung_ = false;
};

/// What palpate-plugin does: loads FILE, opens the arm of that serial number and serves it by the
/// descriptors above, or lists arms (kPluginControl only). Returns the process' exit status.
[[nodiscard]] int servePlugin(const std::filesystem::path& file, const std::string& serial);
/// @see servePlugin
[[nodiscard]] int listPlugin(const std::filesystem::path& file);

}  // namespace palpate
