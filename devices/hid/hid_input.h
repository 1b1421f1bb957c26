/// Stores the newest values of the reports of an arm on a HID device.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/devices/hid/hid_port.h"
#include "palpate/devices/hid/hid_profile.h"

namespace palpate {

/// The newest values that a device has sent. Use each object on one thread only.
class HidInput {
 public:
  explicit HidInput(const HidProfile& profile);  ///< Keeps a reference to the profile. Allocates.

  /// Reads the waiting reports, at most 128. Returns kReport if every report with a joint's field
  /// has come since the last kReport. Returns kNothing if one of these reports is missing, or if
  /// the kernel's ring had overflowed: the waiting reports are then old, so they are discarded.
  /// Returns kGone if the device is gone. RT: as ReportPort::read.
  [[nodiscard]] ReadStatus takeNewest(ReportPort& port) noexcept PALPATE_NONBLOCKING;
  /// Returns true if this report has come since forget() and since the last overflow of the ring.
  [[nodiscard]] bool known(std::size_t report) const noexcept { return known_[report]; }
  /// Returns true if this report came in the last takeNewest().
  [[nodiscard]] bool came(std::size_t report) const noexcept { return came_[report]; }
  /// Returns the last raw value of a field. Before the field's report has come, this is 0; for a
  /// device with rate control it is the value at rest.
  [[nodiscard]] double raw(const FieldRef& field) const noexcept {
    return values_[first_[field.report] + field.field];
  }

  /// Resets to the state before the first report, but keeps the counts.
  void forget() noexcept;
  /// Copies the values of another input of the same profile. RT: no allocation.
  void adopt(const HidInput& other) noexcept;

  /// Numbers of reports since the construction, by their use.
  struct Counts {
    std::int64_t reports = 0;  ///< Calls of takeNewest() that returned kReport.
    std::int64_t taken = 0;    ///< Valid reports of the profile's kinds, not dropped.
    /// Valid reports beyond the first one of a call that returned kReport. With one kind of report,
    /// newer reports have replaced them.
    std::int64_t passed_by = 0;
    std::int64_t dropped = 0;  ///< Reports that were discarded after an overflow of the ring.
    /// Reports that are too short, or have a number that is not in the profile.
    std::int64_t strange = 0;
    /// Repetitions of a report, recognised by HidReportSpec::sequence.
    std::int64_t repeated = 0;
  };
  [[nodiscard]] const Counts& counts() const noexcept { return counts_; }  ///< Counts so far.

 private:
  enum class Taken : std::uint8_t { kUsed, kStrange, kRepeated };
  [[nodiscard]] Taken take(std::span<const std::byte> report) noexcept;

  const HidProfile& profile_;
  /// Bytes before a report's content: 1 if reports have numbers, else 0.
  std::size_t head_ = 0;
  std::vector<std::size_t> first_;  ///< Index of each report's fields in values_.
  std::vector<double> values_;
  std::vector<bool> joints_in_;  ///< For each report: true if it has a joint's field.
  std::vector<bool> fresh_;      ///< For each report: true if it has come since the last kReport.
  std::vector<bool> came_;
  std::vector<bool> known_;
  Counts counts_;
  std::array<std::byte, 2048> buffer_{};
};

}  // namespace palpate
