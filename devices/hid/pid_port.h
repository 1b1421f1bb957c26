/// Private to devices: drives a device of USB's PID class by the magnitudes of its axes.
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

/// State that a device has reported. The reading thread writes it; any thread may read it.
struct PidState {
  static constexpr std::uint32_t kActuators = 1;
  static constexpr std::uint32_t kPower = 2;
  static constexpr std::uint32_t kSafety = 4;
  std::atomic<std::uint32_t> now{0};      ///< Bits of the last report.
  std::atomic<std::uint32_t> ever{0};     ///< Bits that were set at least once since the opening.
  std::atomic<std::uint32_t> buttons{0};  ///< Pressed buttons, like Handle::buttons.
  /// Returns the bits that were set earlier and are not set now. A bit that was never set has no
  /// meaning, because firmware leaves unknown bits at 0.
  [[nodiscard]] std::uint32_t fallen() const noexcept { return ever & ~now; }
};

struct PidParams {
  std::string name;                        ///< Name for error messages, such as "arm mine".
  std::vector<int> axes;                   ///< Axes in the order of the magnitudes; 0 is x.
  double gain = 1.0;                       ///< Share of the device's full force, 0 to 1.
  std::int64_t (*now)() noexcept = nowNs;  ///< Clock [ns].
  std::int64_t settle = 10000000;          ///< Pause after a reset [ns], by the machine's clock.
};

/// One device, from its reset to the end of its last effect. Each axis has an effect with a
/// constant force.
///
/// If duration() > 0, each effect ends by itself after duration(), so the force ends if the writes
/// stop. While magnitudes are written, effects are restarted every quarter of duration(). If
/// duration() is 0, the force stays until a report ends it (stoppingReport). Firmware may take the
/// durations 0 and the largest possible one as infinite, so PidPort avoids these two.
class PidPort final : public ReportPort {
 public:
  /// Intended duration() [s], which is rounded up to counts of the device's duration field.
  static constexpr double kDuration = 0.5;
  static constexpr double kMostDuration = 2.0;  ///< Longest accepted duration() [s].

  /// Resets the device, enables it, sets its gain and starts an effect of magnitude 0 for each
  /// axis. Slow. On failure undoes the steps already done, then throws DeviceError. `map` and
  /// `state` must outlive this object.
  PidPort(const PidMap& map, PidParams params, std::unique_ptr<ReportPort> port, PidState& state);
  /// Sets the magnitudes to 0, ends all effects and disables the actuators.
  ~PidPort() override;

  /// Reads a report from the wrapped port, returns it unchanged, and updates PidState. RT: as the
  /// wrapped port.
  [[nodiscard]] ReadStatus read(std::span<std::byte> to,
                                std::size_t& size) noexcept PALPATE_NONBLOCKING override;
  /// Sends the magnitudes, in the layout of describedBy: one report for each magnitude that has
  /// changed, or for every magnitude when it restarts the effects. Returns false if the device
  /// refuses a report or is gone.
  [[nodiscard]] bool write(std::span<const std::byte> report) noexcept override;
  [[nodiscard]] bool sendFeature(std::span<const std::byte> /*report*/) noexcept override {
    return false;
  }
  [[nodiscard]] int guardDescriptor() const noexcept override { return port_->guardDescriptor(); }

  /// Returns how long an effect lasts [s]; 0: forever, because the device has no duration field.
  [[nodiscard]] double duration() const noexcept { return duration_; }
  /// Returns the median time that sending one magnitude report took in the constructor [s].
  [[nodiscard]] double writeTime() const noexcept { return write_time_; }

 private:
  static constexpr std::size_t kAxes = 3;
  using Bytes = std::vector<std::byte>;
  struct Effect {
    /// Index of the effect's block: given by the device, or counted from 1 if the device has no
    /// report that creates effects. 0: no effect was made.
    int index = 0;
    Bytes set, magnitude, start, stop, free;
    double sent = 0.0;  ///< The magnitude that was sent last; NaN if unknown.
  };

  void open();
  void undo() noexcept;
  [[nodiscard]] bool sendGain() noexcept;
  /// Returns true if no other effect has this index and the reports' fields can hold it.
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

/// Returns the one report, with its number, that stops the force; empty if the device has no such
/// output report.
[[nodiscard]] std::vector<std::byte> stoppingReport(const PidMap& map);

}  // namespace palpate
