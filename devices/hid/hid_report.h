/// Reads and writes numbers in the bytes of a device's reports. Pure: no device is needed.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "palpate/engine/types.h"

namespace palpate {

/// Position and meaning of a number in a report.
struct ReportField {
  /// Encoding of the bits: binary, two's complement, or IEEE 754 in 32 bits.
  enum class Type : std::uint8_t { kUnsigned, kSigned, kFloat };

  std::string name;           ///< Unique among the fields of the inputs, or of the output.
  std::uint32_t bit = 0;      ///< Lowest bit, in the bytes after the report's number.
  std::uint32_t bits = 16;    ///< 1 to 32; a float has 32.
  Type type = Type::kSigned;  ///< Encoding of its bits.
  bool big_endian = false;    ///< In whole bytes, highest first.
  double scale = 1.0;         ///< Input: value = scale * raw + offset; output, the other
  double offset = 0.0;        ///< way round: raw = scale * value + offset.
  double least = 0.0;         ///< Lowest raw number; an output is limited to it.
  double most = 0.0;          ///< Highest raw number; an output is limited to it.
  bool bounded = false;       ///< Profile or descriptor gives both limits.
  bool wraps = false;         ///< A counter that wraps beyond its bits.
  double rest = 0.0;          ///< Output: raw number if no other is set.

  /// Returns the least size of a report with this field [bytes].
  [[nodiscard]] std::size_t end() const noexcept { return (bit + bits + 7) / 8; }
};

/// Returns the raw number in a report that is long enough. RT: no allocation.
[[nodiscard]] double rawOf(std::span<const std::byte> report,
                           const ReportField& field) noexcept PALPATE_NONBLOCKING;
/// Writes a raw number, rounded and limited to least and most; keeps other bits. A number that is
/// not finite becomes 0. RT: no allocation.
void putRaw(std::span<std::byte> report, const ReportField& field,
            double raw) noexcept PALPATE_NONBLOCKING;

/// Extends a counter of `bits` bits beyond its ends. Correct if it moves less than half its range
/// between two readings.
class Unwrapped {
 public:
  /// Returns the extended count. The first reading becomes the number nearest to `about` that has
  /// these bits.
  [[nodiscard]] double follow(double raw, std::uint32_t bits,
                              double about) noexcept PALPATE_NONBLOCKING;
  void forget() noexcept { known_ = false; }  ///< The next reading counts as the first.
  [[nodiscard]] bool known() const noexcept { return known_; }  ///< There was a first reading.

 private:
  bool known_ = false;
  double raw_ = 0.0;
  double turns_ = 0.0;  ///< Sum of the ranges added at the ends.
};

}  // namespace palpate
