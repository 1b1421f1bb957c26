/// Conversion of 16-bit floating-point numbers (IEEE 754 binary16). Needs no other library.
#pragma once

#include <bit>
#include <cstdint>

namespace palpate {

/// Converts a 16-bit number to a float, exactly. Infinities and NaN are kept.
[[nodiscard]] constexpr float floatOfHalf(std::uint16_t half) noexcept {
  const std::uint32_t sign = (std::uint32_t{half} & 0x8000U) << 16U;
  const std::uint32_t rest = (std::uint32_t{half} & 0x7FFFU) << 13U;
  // Changes the bias of the exponent from 15 to 127. Subnormal 16-bit numbers become differences of
  // normal floats, so they are right even if the processor flushes subnormal floats to zero.
  constexpr std::uint32_t kBias = (127U - 15U) << 23U;
  constexpr std::uint32_t kLeast = kBias + (1U << 23U);
  if (rest < (1U << 23U)) {
    const float size = std::bit_cast<float>(rest + kLeast) - std::bit_cast<float>(kLeast);
    return std::bit_cast<float>(std::bit_cast<std::uint32_t>(size) | sign);
  }
  const std::uint32_t endless = rest >= (0x7C00U << 13U) ? kBias : 0U;
  return std::bit_cast<float>((rest + kBias + endless) | sign);
}

/// Returns the nearest 16-bit number; rounds ties to even. Infinite for magnitudes of 65520 and
/// more. NaN stays NaN.
[[nodiscard]] constexpr std::uint16_t halfOfFloat(float value) noexcept {
  const auto bits = std::bit_cast<std::uint32_t>(value);
  const std::uint32_t sign = (bits >> 16U) & 0x8000U;
  const std::uint32_t size = bits & 0x7FFFFFFFU;
  std::uint32_t half = 0;
  if (size > 0x7F800000U) {
    half = 0x7E00U;
  } else if (size >= 0x477FF000U) {
    half = 0x7C00U;
  } else if (size < 0x38800000U) {
    // Rounds to a subnormal result: adds a float whose last bit has the weight of the result's last
    // bit.
    constexpr std::uint32_t kAdded = ((127U - 15U) + (23U - 10U) + 1U) << 23U;
    const float sum = std::bit_cast<float>(size) + std::bit_cast<float>(kAdded);
    half = std::bit_cast<std::uint32_t>(sum) - kAdded;
  } else {
    const std::uint32_t odd = (size >> 13U) & 1U;
    half = (size + 0xFFFU + odd - ((127U - 15U) << 23U)) >> 13U;
  }
  return static_cast<std::uint16_t>(half | sign);
}

}  // namespace palpate
