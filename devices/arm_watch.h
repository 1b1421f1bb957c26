/// What an arm says, for the eyes of who writes its profile. Nothing is sent to it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "palpate/devices/hid_port.h"
#include "palpate/devices/hid_profile.h"

namespace palpate {

/// Reads reports as a profile has them and says what they come to. One thread.
///
/// Joints are what they are to HidDevice, but that nobody homes the arm: a counter that wraps is
/// taken for the one nearest to the middle of the hand's world, and where the home pose is how the
/// arm is opened, that is how it stood when its first reports came.
class ArmWatch {
 public:
  explicit ArmWatch(HidProfile profile);  ///< Of a parsed profile; takes milliseconds (factsOf).

  /// Takes all that waits. kGone: it was unplugged.
  ///
  /// @param now  [ns]
  [[nodiscard]] Got take(ReportPort& port, std::int64_t now);

  /// Each report with its bytes, its rate since the last picture and how old it is; every field,
  /// raw and as a value; joints, the tip, flags; in lines. What has stopped says since when.
  [[nodiscard]] std::string picture(std::int64_t now);

 private:
  static constexpr std::size_t kNoSpec = static_cast<std::size_t>(-1);
  static constexpr std::size_t kMostStrange = 8;  ///< Kinds that the profile does not know.

  struct Kind {
    std::size_t spec = kNoSpec;  ///< Of HidProfile::input.
    std::uint8_t id = 0;
    std::vector<std::byte> bytes;  ///< As it came last, its number among them.
    std::int64_t count = 0;        ///< Since the last picture,
    std::int64_t total = 0;        ///< and since the beginning.
    std::int64_t at = 0;           ///< [ns], the last one.
  };

  [[nodiscard]] Kind* kindOf(std::span<const std::byte> report);
  /// After the number; empty: none has come, or it is too short for the field.
  [[nodiscard]] std::span<const std::byte> bodyFor(const FieldRef& field) const;
  void follow();
  [[nodiscard]] std::string wordsOf(const Kind& kind, std::int64_t now) const;
  [[nodiscard]] std::string arm(std::int64_t now) const;

  HidProfile profile_;
  bool numbered_ = false;
  std::vector<Kind> kinds_;  ///< Those of the profile first, in its order.
  std::vector<Unwrapped> counters_;
  std::vector<double> about_;     ///< Raw, of counters.
  std::vector<double> home_raw_;  ///< Of joints, where they were first.
  std::vector<bool> seen_;        ///< A joint's field has come.
  Joints joints_{};
  std::int64_t passed_by_ = 0;  ///< Strange kinds beyond kMostStrange.
  std::int64_t span_ = 0;       ///< [ns], the last picture.
  bool begun_ = false;
  std::vector<std::byte> buffer_;
};

}  // namespace palpate
