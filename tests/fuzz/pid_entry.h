/// Passes arbitrary bytes to the PID driver, as a descriptor and as reports. The random test and
/// libFuzzer share this code.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdlib>
#include <memory>
#include <span>
#include <vector>

#include "palpate/devices/hid/hid_device.h"
#include "palpate/devices/hid/pid_descriptor.h"
#include "palpate/devices/hid/pid_port.h"
#include "palpate/engine/error.h"

namespace palpate::test {

/// A port whose reads return the fuzzer's bytes. Accepts all writes that are not empty.
class SayingPort final : public ReportPort {
 public:
  explicit SayingPort(std::span<const std::byte> says) : says_(says) {}
  [[nodiscard]] ReadStatus read(std::span<std::byte> to, std::size_t& size) noexcept override {
    if (says_.empty()) return ReadStatus::kNothing;
    size = take(to);
    return ReadStatus::kReport;
  }
  [[nodiscard]] bool write(std::span<const std::byte> report) noexcept override {
    return !report.empty();
  }
  [[nodiscard]] bool sendFeature(std::span<const std::byte> report) noexcept override {
    return !report.empty();
  }
  [[nodiscard]] bool getFeature(std::span<std::byte> report, std::size_t& size) noexcept override {
    if (says_.empty()) return false;
    size = take(report);
    return size > 0;
  }

 private:
  /// Copies the next report from the fuzzer's bytes to `to`, and returns its length. The first byte
  /// determines the length, at most 47.
  std::size_t take(std::span<std::byte> to) noexcept {
    std::size_t size = std::to_integer<std::size_t>(says_[0]) % 48;
    says_ = says_.subspan(1);
    size = std::min({size, says_.size(), to.size()});
    std::copy_n(says_.begin(), size, to.begin());
    says_ = says_.subspan(size);
    return size;
  }
  std::span<const std::byte> says_;
};

inline void must(bool good) {
  if (!good) std::abort();
}

/// Returns true if the descriptor is that of a PID device that could be opened. Aborts if a result
/// of the driver is impossible.
inline bool fuzzPid(std::span<const std::byte> descriptor, std::span<const std::byte> says) {
  const auto device = parseHidDescriptor(descriptor);
  if (!device) return false;
  for (const DescribedFields& of : device->fields) {
    const auto report = std::find_if(device->reports.begin(), device->reports.end(),
                                     [&](auto& r) { return r.way == of.way && r.id == of.id; });
    must(report != device->reports.end() && of.bits > 0 && of.count > 0);
    must(of.bit + std::uint64_t{of.bits} * of.count <= 8 * report->size);
    (void)of.usage(of.count - 1);
    (void)of.placeOf(pid::kStopAll);
  }
  try {
    const PidMap map = readPidMap(*device, "fuzz");
    static const std::shared_ptr<const Kinematics> kSlides = makeSlides(std::array{0, 1});
    HidProfile profile;
    profile.pid = {{0, 0.2, 5.0}, {1, -0.2, -5.0}};
    profile.kinematics = kSlides;
    const HidProfile described = describedBy(map, profile);
    for (const HidReportSpec& spec : described.input) {
      for (const ReportField& field : spec.fields) must(field.end() <= spec.size);
    }
    must(stoppingReport(map).size() <= 16385);
    PidState state;
    PidParams params;
    params.name = "fuzz";
    params.axes = {0, 1};
    params.gain = 0.1;
    params.settle = 0;
    PidPort port(map, params, std::make_unique<SayingPort>(says), state);
    must(port.duration() >= 0.0 && port.duration() <= PidPort::kMostDuration);
    HidInput input(described);
    for (int i = 0; i < 8; ++i) {
      (void)input.takeNewest(port);
      std::array<std::byte, 9> force{};
      for (std::size_t k = 1; k < force.size(); ++k) {
        if (!says.empty()) force[k] = says[(static_cast<std::size_t>(i) * 8 + k) % says.size()];
      }
      must(port.write(force));
    }
    return true;
  } catch (const DeviceError&) {
    return false;
  }
}

}  // namespace palpate::test
