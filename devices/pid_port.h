/// Private to devices: between magnitudes of axes and a device of USB's PID class: its effects are
/// made, fed, renewed and taken away, and what it says of its state is kept.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/devices/hid_port.h"
#include "palpate/devices/pid_descriptor.h"
#include "palpate/engine/realtime.h"

namespace palpate {

/// What a device has said of itself. Written by whoever reads its port, read by the same or another
/// thread.
struct PidState {
  static constexpr std::uint32_t kActuators = 1;
  static constexpr std::uint32_t kPower = 2;
  static constexpr std::uint32_t kSafety = 4;
  std::atomic<std::uint32_t> now{0};      ///< Bits as they were said last.
  std::atomic<std::uint32_t> ever{0};     ///< Bits that have been said since the opening.
  std::atomic<std::uint32_t> buttons{0};  ///< As Handle::buttons.
  /// Those that it has said and says no more. What was never said means nothing: firmware leaves
  /// bits at 0 that it does not know.
  [[nodiscard]] std::uint32_t fallen() const noexcept { return ever & ~now; }
};

/// How an arm is driven.
struct PidParams {
  std::string name;                        ///< In errors, as "arm mine".
  std::vector<int> axes;                   ///< In the order of magnitudes; 0 is x.
  double gain = 1.0;                       ///< Of its full force, 0 to 1.
  std::int64_t (*now)() noexcept = nowNs;  ///< [ns]
  std::int64_t settle = 10000000;          ///< After a reset [ns], of the machine's clock.
};

/// One device, from its reset to its last effect's end: a constant force an axis.
///
/// No effect lasts: each ends by itself after duration() and is started anew after a quarter of
/// that, as long as magnitudes are written. Where nobody writes the force ends; 0 and the most that
/// the device can say, which firmware takes for ever or for nothing, are never sent.
class PidPort final : public ReportPort {
 public:
  static constexpr double kDuration = 0.5;      ///< [s], the least that the device can say above;
  static constexpr double kMostDuration = 2.0;  ///< [s], at most.

  /// Resets it, enables it, sets its gain, makes an effect an axis and starts all of them with
  /// magnitude 0. Slow. Throws DeviceError, with what it has begun undone.
  ///
  /// @param map    Outlives it; so does `state`.
  PidPort(const PidMap& map, PidParams params, std::unique_ptr<ReportPort> port, PidState& state);
  /// Magnitudes 0; stops and frees the effects, stops all, disables the actuators.
  ~PidPort() override;

  /// Reports as they are; keeps PidState. RT: as the port's own.
  [[nodiscard]] Got read(std::span<std::byte> to,
                         std::size_t& size) noexcept PALPATE_NONBLOCKING override;
  /// Magnitudes, as describedBy has them: a report for each that is another than it was. False:
  /// gone.
  [[nodiscard]] bool write(std::span<const std::byte> report) noexcept override;
  [[nodiscard]] bool sendFeature(std::span<const std::byte> /*report*/) noexcept override {
    return false;
  }
  [[nodiscard]] int guardDescriptor() const noexcept override { return port_->guardDescriptor(); }

  /// How long an effect lasts [s]; 0: the device knows no durations, and effects last for ever.
  [[nodiscard]] double duration() const noexcept { return duration_; }
  /// What one of the reports with a magnitude takes, measured at the opening, the middle of some
  /// [s].
  [[nodiscard]] double writeTime() const noexcept { return write_time_; }

 private:
  static constexpr std::size_t kAxes = 3;
  using Bytes = std::vector<std::byte>;
  struct Effect {
    int index = 0;  ///< Of its block, as the device counts; 0: none.
    Bytes set, magnitude, start, stop, free;
    double sent = 0.0;  ///< The magnitude that it has; not a number where that is not known.
  };

  void open();
  void undo() noexcept;
  [[nodiscard]] bool sendGain() noexcept;
  /// No other effect has it, and it can be told.
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
  std::int64_t started_ = 0;  ///< [ns], the effects, last.
  std::int64_t enabled_ = 0;  ///< [ns], the actuators, last.
};

/// The one report that takes the force off a device, its number first; empty: there is none that
/// write() takes.
[[nodiscard]] std::vector<std::byte> stoppingReport(const PidMap& map);

}  // namespace palpate
