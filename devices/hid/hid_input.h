/// The input of an arm on a HID device: the newest values of its reports.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/devices/hid/hid_port.h"
#include "palpate/devices/hid/hid_profile.h"

namespace palpate {

/// The newest values that a device has sent. For one thread.
class HidInput {
 public:
  explicit HidInput(const HidProfile& profile);  ///< Keeps a reference to the profile. Allocates.

  /// Takes all waiting reports. Returns kReport if all reports with a joint's field are new.
  /// Returns kNothing also if the kernel's ring had overflowed, since its reports were old. RT: as
  /// ReportPort::read.
  [[nodiscard]] ReadStatus takeNewest(ReportPort& port) noexcept PALPATE_NONBLOCKING;
  /// Returns true if this report has come since forget() and no overflow has lost reports since.
  [[nodiscard]] bool known(std::size_t report) const noexcept { return known_[report]; }
  /// Returns true if the last takeNewest has taken this report.
  [[nodiscard]] bool came(std::size_t report) const noexcept { return came_[report]; }
  /// Returns the last raw value of a field. Before the first report it is 0, or with rate control
  /// the value of a puck at rest. This holds for the fields of each report.
  [[nodiscard]] double raw(const FieldRef& field) const noexcept {
    return values_[first_[field.report] + field.field];
  }

  /// Returns to the state before the first report, but keeps the counts.
  void forget() noexcept;
  /// Takes over the values of another input of the same profile. RT: no allocation.
  void adopt(const HidInput& other) noexcept;

  /// Numbers of reports since the construction, by their use.
  struct Counts {
    std::int64_t reports = 0;    ///< Used.
    std::int64_t taken = 0;      ///< Every kind that the profile has.
    std::int64_t passed_by = 0;  ///< Not used, because a newer one waited.
    std::int64_t dropped = 0;    ///< Discarded after an overflow of the ring.
    std::int64_t strange = 0;    ///< Too short, or with a number that the profile does not have.
    std::int64_t repeated = 0;   ///< Sent again, by HidReportSpec::sequence.
  };
  [[nodiscard]] const Counts& counts() const noexcept { return counts_; }  ///< Counts so far.

 private:
  enum class Taken : std::uint8_t { kUsed, kStrange, kRepeated };
  [[nodiscard]] Taken take(std::span<const std::byte> report) noexcept;

  const HidProfile& profile_;
  std::size_t head_ = 0;            ///< Bytes of the number before a report: 1 if reports are
                                    ///< numbered.
  std::vector<std::size_t> first_;  ///< Index of each report's fields in values_.
  std::vector<double> values_;
  std::vector<bool> joints_in_;  ///< The report has a joint's field.
  std::vector<bool> fresh_;      ///< The report has come since the last kReport.
  std::vector<bool> came_;       ///< The report has come in the last takeNewest.
  std::vector<bool> known_;      ///< The report has come since forget() and the last overflow.
  Counts counts_;
  std::array<std::byte, 2048> buffer_{};
};

}  // namespace palpate
