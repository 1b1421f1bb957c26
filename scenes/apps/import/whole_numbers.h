/// Subtracts an offset from whole numbers that are too large for floats, to keep their differences
/// exact.
#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <type_traits>

#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/shared.h"

namespace palpate::importer {

/// Returns value - offset. For 64-bit integers, the result is exact if its magnitude is below 2^52.
template <class T>
[[nodiscard]] double minus(T value, double offset) {
  const double near = static_cast<double>(value) - offset;
  if constexpr (std::is_integral_v<T> && sizeof(T) == 8) {
    constexpr double kExact = 4503599627370496.0;  // 2^52
    if (offset != 0.0 && std::abs(near) < kExact) {
      const auto whole = offset < 0.0
                             ? static_cast<std::uint64_t>(static_cast<std::int64_t>(offset))
                             : static_cast<std::uint64_t>(offset);
      return static_cast<double>(
          static_cast<std::int64_t>(static_cast<std::uint64_t>(value) - whole));
    }
  }
  return near;
}

/// Returns the offset after which floats hold a scalar's whole numbers. Returns 0 if no offset is
/// needed, if the numbers differ by more than 2^24, or if the array does not have whole numbers.
/// @param lowest, highest  Range of the numbers, without fill values.
[[nodiscard]] double wholeOffset(const Array& array, double lowest, double highest);

/// Returns the loss of converting whole numbers in this range to floats.
[[nodiscard]] Loss wholeLoss(double lowest, double highest);

/// Subtracts the offset of a scalar if it needs one (Array::value_offset). Stores a message about
/// values that floats cannot represent (Values::setLost).
/// @param series  Offset of this array in the earlier steps, which all steps must share. At the
///                first step, `series` has no value, and the function sets it.
/// @param shared  Process group. All ranks find the same offset.
void subtractOffset(Array& array, std::optional<double>& series, const Shared& shared);

}  // namespace palpate::importer
