/// Private to devices: drives a device of USB's PID class by magnitudes of its axes. Creates,
/// updates, renews and frees the effects, and keeps the state that the device reports.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/devices/hid/hid_port.h"
#include "palpate/devices/hid/pid_descriptor.h"
#include "palpate/engine/loop/realtime.h"

namespace palpate {

/// State that a device has reported. Written by the thread that reads its port, read by that thread
/// or another.
struct PidState {
  static constexpr std::uint32_t kActuators = 1;
  static constexpr std::uint32_t kPower = 2;
  static constexpr std::uint32_t kSafety = 4;
  std::atomic<std::uint32_t> now{0};      ///< Bits as last reported.
  std::atomic<std::uint32_t> ever{0};     ///< Bits that were ever set since the opening.
  std::atomic<std::uint32_t> buttons{0};  ///< Pressed buttons, like Handle::buttons.
  /// Returns the bits that were set and are no longer set. Bits that were never set have no
  /// meaning: firmware leaves bits at 0 that it does not know.
  [[nodiscard]] std::uint32_t fallen() const noexcept { return ever & ~now; }
};

/// Settings of a PidPort.
struct PidParams {
  std::string name;                        ///< Name in errors, such as "arm mine".
  std::vector<int> axes;                   ///< In the order of magnitudes; 0 is x.
  double gain = 1.0;                       ///< Share of its full force, 0 to 1.
  std::int64_t (*now)() noexcept = nowNs;  ///< [ns]
  std::int64_t settle = 10000000;          ///< Pause after a reset [ns], by the machine's clock.
};

/// One device, from its reset to the end of its last effect. Each axis has a constant force.
///
/// If duration() > 0, each effect ends by itself after duration(), so the force ends if the writes
/// stop; while magnitudes are written, it is started again after a quarter of duration(). If
/// duration() is 0, the force stays, and only a report ends it (stoppingReport). Durations that
/// firmware may take as infinite, 0 and the largest that the device can express, are never sent.
class PidPort final : public ReportPort {
 public:
  static constexpr double kDuration = 0.5;      ///< Wanted duration() [s], rounded up to counts.
  static constexpr double kMostDuration = 2.0;  ///< [s], longest duration().

  /// Resets the device, enables it, sets its gain, makes an effect for each axis and starts all
  /// effects with magnitude 0. Slow. Throws DeviceError, after undoing the steps already done.
  ///
  /// @param map    Must outlive this object; so must `state`.
  PidPort(const PidMap& map, PidParams params, std::unique_ptr<ReportPort> port, PidState& state);
  /// Sets magnitudes to 0; stops and frees the effects, stops all, disables the actuators.
  ~PidPort() override;

  /// Passes reports on unchanged; updates PidState. RT: as the port's own.
  [[nodiscard]] ReadStatus read(std::span<std::byte> to,
                                std::size_t& size) noexcept PALPATE_NONBLOCKING override;
  /// Sends the magnitudes, in the layout of describedBy: a report for each one that has changed.
  /// Returns false if the device is gone.
  [[nodiscard]] bool write(std::span<const std::byte> report) noexcept override;
  [[nodiscard]] bool sendFeature(std::span<const std::byte> /*report*/) noexcept override {
    return false;
  }
  [[nodiscard]] int guardDescriptor() const noexcept override { return port_->guardDescriptor(); }

  /// Returns how long an effect lasts [s]; 0: the device does not support durations, and effects
  /// last forever.
  [[nodiscard]] double duration() const noexcept { return duration_; }
  /// Returns the time to send one magnitude report [s], the median of several at the opening.
  [[nodiscard]] double writeTime() const noexcept { return write_time_; }

 private:
  static constexpr std::size_t kAxes = 3;
  using Bytes = std::vector<std::byte>;
  struct Effect {
    int index = 0;  ///< Index of its block, from the device; 0: not made.
    Bytes set, magnitude, start, stop, free;
    double sent = 0.0;  ///< The magnitude last sent; NaN if not known.
  };

  void open();
  void undo() noexcept;
  [[nodiscard]] bool sendGain() noexcept;
  /// Returns true if no other effect has this index and the reports can carry it.
  [[nodiscard]] bool goodIndex(double index) const noexcept;
  [[nodiscard]] int makeEffect();
  [[nodiscard]] int loadedIndex();
  void prepare(Effect& effect, int axis);
  void measure();
  [[nodiscard]] bool send(const PidReport& report, const Bytes& bytes) noexcept;
  void require(bool good, const char* what) const;
  [[nodiscard]] bool control(std::uint32_t usage) noexcept;
  [[nodiscard]] bool sendMagnitude(Effect& effect, double raw) noexcept;
  [[nodiscard]] bool renew(bool enable) noexcept;
  void keepState(std::span<const std::byte> report) noexcept;

  const PidMap& map_;
  PidParams params_;
  std::unique_ptr<ReportPort> port_;
  PidState& state_;
  double duration_ = 0.0;
  double write_time_ = 0.0;
  std::vector<Effect> effects_;
  std::int64_t started_ = 0;  ///< Last start of the effects [ns].
  std::int64_t enabled_ = 0;  ///< Last time the actuators were enabled [ns].
};

/// Returns the single report, its number first, that takes the force off a device. Empty if write()
/// cannot send it.
[[nodiscard]] std::vector<std::byte> stoppingReport(const PidMap& map);

}  // namespace palpate
