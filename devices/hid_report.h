/// Numbers in the bytes of a device's reports. Pure: no device is needed.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "palpate/engine/types.h"

namespace palpate {

/// Where a number is in a report, and what it counts.
struct ReportField {
  /// How bits are a number: binary, two's complement, or IEEE 754 in 32 bits.
  enum class Type : std::uint8_t { kUnsigned, kSigned, kFloat };

  std::string name;           ///< Its own among the input's fields, or the output's.
  std::uint32_t bit = 0;      ///< Its lowest one, of the bytes after the report's number.
  std::uint32_t bits = 16;    ///< 1 to 32; a float has 32.
  Type type = Type::kSigned;  ///< What its bits hold.
  bool big_endian = false;    ///< Whole bytes, highest first.
  double scale = 1.0;         ///< value = scale * raw + offset; of what is sent, raw =
  double offset = 0.0;        ///< scale * value + offset.
  double least = 0.0;         ///< Raw, of what is sent: beyond these it is cut off.
  double most = 0.0;          ///< Raw, likewise, the upper end.
  bool bounded = false;       ///< Whoever described it gave both.
  bool wraps = false;         ///< A counter that begins anew beyond its bits.
  double rest = 0.0;          ///< Raw, of what is sent, where nothing else is to be.

  /// Bytes of a report that has it.
  [[nodiscard]] std::size_t end() const noexcept { return (bit + bits + 7) / 8; }
};

/// The raw number in a report that is long enough. RT: no allocation.
[[nodiscard]] double rawOf(std::span<const std::byte> report,
                           const ReportField& field) noexcept PALPATE_NONBLOCKING;
/// Puts a raw number in, rounded and cut off at least and most; other bits stay. What is not finite
/// is 0. RT: no allocation.
void putRaw(std::span<std::byte> report, const ReportField& field,
            double raw) noexcept PALPATE_NONBLOCKING;

/// Follows a counter of so many bits beyond its ends: right while it counts less than half its
/// range between two readings.
class Unwrapped {
 public:
  /// The count since the first reading, which is the one nearest to `about` that has these bits.
  [[nodiscard]] double follow(double raw, std::uint32_t bits,
                              double about) noexcept PALPATE_NONBLOCKING;
  void forget() noexcept { known_ = false; }  ///< The next reading is the first again.
  [[nodiscard]] bool known() const noexcept { return known_; }  ///< There is a first reading.

 private:
  bool known_ = false;
  double raw_ = 0.0;
  double turns_ = 0.0;  ///< What its ends have added.
};

}  // namespace palpate
