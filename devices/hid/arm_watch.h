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

/// Reads reports by a profile and prints their values. Use each object on one thread only.
///
/// Joints are computed as in HidDevice, except that the arm is not homed. The first value of a
/// counter that wraps is taken as the one nearest to the middle of the hand's world. If the profile
/// has home_at_open, the home pose is the pose at the arm's first reports.
class ArmWatch {
 public:
  /// Watches an arm with this profile. Slow (milliseconds), because it calls factsOf().
  explicit ArmWatch(HidProfile profile);

  /// Reads all waiting reports. Returns kGone if the device was unplugged.
  ///
  /// @param now  [ns]
  [[nodiscard]] ReadStatus take(ReportPort& port, std::int64_t now);

  /// Returns lines of text: each report with its bytes, its age and its rate since the last call;
  /// every field, raw and as a value; joints, tip and flags. For a report that no longer comes,
  /// prints the time since its last arrival.
  [[nodiscard]] std::string picture(std::int64_t now);

 private:
  static constexpr std::size_t kNoSpec = static_cast<std::size_t>(-1);
  /// Largest number of report kinds that are shown although the profile does not have them.
  static constexpr std::size_t kMostStrange = 8;

  struct Kind {
    std::size_t spec = kNoSpec;  ///< Index in HidProfile::input.
    std::uint8_t id = 0;
    std::vector<std::byte> bytes;  ///< Bytes of the last report, with its number.
    std::int64_t count = 0;        ///< Reports since the last call of picture().
    std::int64_t total = 0;        ///< Reports since this object was made.
    std::int64_t at = 0;           ///< Time of the last report [ns].
  };

  [[nodiscard]] Kind* kindOf(std::span<const std::byte> report);
  /// Returns a report's bytes after its number. Returns no bytes if the report has not come, or is
  /// too short for the field.
  [[nodiscard]] std::span<const std::byte> bodyFor(const FieldRef& field) const;
  void follow();
  [[nodiscard]] std::string wordsOf(const Kind& kind, std::int64_t now) const;
  [[nodiscard]] std::string arm(std::int64_t now) const;

  HidProfile profile_;
  bool numbered_ = false;
  std::vector<Kind> kinds_;  ///< Kinds of the profile in its order, then others.
  std::vector<Unwrapped> counters_;
  /// Raw values near which the first reading of each counter is placed.
  std::vector<double> about_;
  std::vector<double> home_raw_;  ///< First raw values of the joints' fields.
  std::vector<bool> seen_;        ///< The joint's field has had a value.
  Joints joints_{};
  std::int64_t passed_by_ = 0;  ///< Reports of further kinds, after kMostStrange unknown kinds.
  std::int64_t span_ = 0;       ///< Time of the last call of picture() [ns].
  bool begun_ = false;
  std::vector<std::byte> buffer_;
};

}  // namespace palpate
