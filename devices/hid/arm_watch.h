/// Shows the reports of an arm to the author of its profile. Sends no data to the arm.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "palpate/devices/hid/hid_port.h"
#include "palpate/devices/hid/hid_profile.h"

namespace palpate {

/// Reads reports by a profile and prints their values. For one thread.
///
/// Joints are computed as in HidDevice, except that the arm is not homed. The first value of a
/// counter that wraps is the one nearest to the middle of the hand's world. If the profile has
/// home_at_open, the home pose is the pose at the arm's first reports.
class ArmWatch {
 public:
  explicit ArmWatch(HidProfile profile);  ///< Takes a parsed profile and milliseconds (factsOf).

  /// Takes all waiting reports. Returns kGone if the device was unplugged.
  ///
  /// @param now  [ns]
  [[nodiscard]] ReadStatus take(ReportPort& port, std::int64_t now);

  /// Returns lines of text: each report with its bytes, its rate since the last picture and its
  /// age; every field, raw and as a value; joints, tip and flags. A report that has stopped is
  /// shown with the time since it last came.
  [[nodiscard]] std::string picture(std::int64_t now);

 private:
  static constexpr std::size_t kNoSpec = static_cast<std::size_t>(-1);
  static constexpr std::size_t kMostStrange = 8;  ///< Most kinds beyond the profile's.

  struct Kind {
    std::size_t spec = kNoSpec;  ///< Index in HidProfile::input.
    std::uint8_t id = 0;
    std::vector<std::byte> bytes;  ///< The last report, with its number.
    std::int64_t count = 0;        ///< Reports since the last picture.
    std::int64_t total = 0;        ///< Reports since the beginning.
    std::int64_t at = 0;           ///< Time of the last report [ns].
  };

  [[nodiscard]] Kind* kindOf(std::span<const std::byte> report);
  /// Returns the bytes after the report number. Empty if the report has not come, or is too short
  /// for the field.
  [[nodiscard]] std::span<const std::byte> bodyFor(const FieldRef& field) const;
  void follow();
  [[nodiscard]] std::string wordsOf(const Kind& kind, std::int64_t now) const;
  [[nodiscard]] std::string arm(std::int64_t now) const;

  HidProfile profile_;
  bool numbered_ = false;
  std::vector<Kind> kinds_;  ///< The profile's kinds first, in its order.
  std::vector<Unwrapped> counters_;
  std::vector<double> about_;     ///< References of counters, raw.
  std::vector<double> home_raw_;  ///< First values of joints' fields, raw.
  std::vector<bool> seen_;        ///< A value of the joint's field has come.
  Joints joints_{};
  std::int64_t passed_by_ = 0;  ///< Reports of kinds beyond kMostStrange.
  std::int64_t span_ = 0;       ///< Time of the last picture [ns].
  bool begun_ = false;
  std::vector<std::byte> buffer_;
};

}  // namespace palpate
