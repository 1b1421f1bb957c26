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

/// Decodes an arm's reports by a profile and formats their values. Use each object on one thread.
///
/// Computes joints like HidDevice, but without homing: a counter that wraps begins in the range
/// nearest to its value at ProfileFacts::middle. With home_at_open, the first reports give the home
/// pose.
class ArmWatch {
 public:
  /// Slow (milliseconds), because it calls factsOf().
  explicit ArmWatch(HidProfile profile);

  /// Reads the waiting reports, at most 512. Returns kGone if the device was unplugged.
  ///
  /// @param now  Time of the call [ns].
  [[nodiscard]] ReadStatus take(ReportPort& port, std::int64_t now);

  /// Returns lines of text: each report with its first 64 bytes, its age and its rate since the
  /// last call; every field, raw and as a value; joints, tip and flags.
  [[nodiscard]] std::string picture(std::int64_t now);

 private:
  static constexpr std::size_t kNoSpec = static_cast<std::size_t>(-1);
  /// Largest number of unknown report kinds that are shown.
  static constexpr std::size_t kMostStrange = 8;

  struct Kind {
    std::size_t spec = kNoSpec;  ///< Index in HidProfile::input.
    std::uint8_t id = 0;
    std::vector<std::byte> bytes;  ///< Last report, with its number.
    std::int64_t count = 0;        ///< Reports since the last picture().
    std::int64_t total = 0;
    std::int64_t at = 0;  ///< Time of the last report [ns].
  };

  [[nodiscard]] Kind* kindOf(std::span<const std::byte> report);
  /// Returns a report's bytes after its number; empty if the report is missing or too short.
  [[nodiscard]] std::span<const std::byte> bodyFor(const FieldRef& field) const;
  void follow();
  [[nodiscard]] std::string wordsOf(const Kind& kind, std::int64_t now) const;
  [[nodiscard]] std::string arm(std::int64_t now) const;

  HidProfile profile_;
  bool numbered_ = false;
  std::vector<Kind> kinds_;  ///< Kinds of the profile in its order, then others.
  std::vector<Unwrapped> counters_;
  /// Raw value to which the first reading of each counter must be nearest.
  std::vector<double> about_;
  std::vector<double> home_raw_;  ///< First raw values of the joints' fields.
  std::vector<bool> seen_;
  Joints joints_{};
  /// Reports of further unknown kinds, beyond kMostStrange; they are not shown.
  std::int64_t passed_by_ = 0;
  std::int64_t span_ = 0;  ///< Time of the last picture(); at first, of the first take() [ns].
  bool begun_ = false;
  std::vector<std::byte> buffer_;
};

}  // namespace palpate
