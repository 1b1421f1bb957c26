/// Reads and writes numbers in the bytes of a device's reports. Needs no device.
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
  std::uint32_t bit = 0;      ///< Index of the lowest bit, in the bytes after the report's number.
  std::uint32_t bits = 16;    ///< 1 to 32; a float has 32.
  Type type = Type::kSigned;  ///< Encoding of its bits.
  bool big_endian = false;    ///< True: the field consists of whole bytes, highest byte first.
  /// Input: value = scale * raw + offset. Output: raw = scale * value + offset.
  double scale = 1.0;
  double offset = 0.0;   ///< See `scale`.
  double least = 0.0;    ///< Lowest raw number; output values are limited to it.
  double most = 0.0;     ///< Highest raw number; output values are limited to it.
  bool bounded = false;  ///< The profile or the descriptor gives both limits.
  bool wraps = false;    ///< The field is a counter that wraps around after its highest value.
  double rest = 0.0;     ///< Output: raw number that is sent if no value is set.

  /// Returns the size of the smallest report that contains this field [bytes].
  [[nodiscard]] std::size_t end() const noexcept { return (bit + bits + 7) / 8; }
};

/// Returns the raw number in a report, which must be long enough. RT: no allocation.
[[nodiscard]] double rawOf(std::span<const std::byte> report,
                           const ReportField& field) noexcept PALPATE_NONBLOCKING;
/// Writes a raw number, limited to `least` and `most`; keeps all other bits. Integer fields round
/// the number. Writes 0 if the number is not finite. RT: no allocation.
void putRaw(std::span<std::byte> report, const ReportField& field,
            double raw) noexcept PALPATE_NONBLOCKING;

/// Extends a counter that wraps around. Between two readings the counter must move by less than
/// half of its range.
class Unwrapped {
 public:
  /// Returns the extended count of a reading `raw` of a counter with `bits` bits. The first count
  /// after forget() is the one nearest to `about`.
  [[nodiscard]] double follow(double raw, std::uint32_t bits,
                              double about) noexcept PALPATE_NONBLOCKING;
  void forget() noexcept { known_ = false; }  ///< The next reading counts as the first one again.
  /// Returns true if a reading has come since forget().
  [[nodiscard]] bool known() const noexcept { return known_; }

 private:
  bool known_ = false;
  double raw_ = 0.0;
  double turns_ = 0.0;  ///< Sum of the added ranges.
};

}  // namespace palpate
