#include "palpate/devices/hid/hid_report.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace palpate {

namespace {

struct BitPlace {
  std::size_t byte;
  unsigned bit;
};

BitPlace bitPlaceOf(const ReportField& field, std::uint32_t k) noexcept {
  if (!field.big_endian) return {(field.bit + k) / 8, (field.bit + k) % 8};
  return {field.bit / 8 + (field.bits - 1 - k) / 8, k % 8};
}

}  // namespace

double rawOf(std::span<const std::byte> report, const ReportField& field) noexcept {
  std::uint32_t raw = 0;
  for (std::uint32_t k = 0; k < field.bits; ++k) {
    const BitPlace place = bitPlaceOf(field, k);
    if (((report[place.byte] >> place.bit) & std::byte{1}) != std::byte{0}) raw |= 1U << k;
  }
  switch (field.type) {
    case ReportField::Type::kFloat:
      return static_cast<double>(std::bit_cast<float>(raw));
    case ReportField::Type::kSigned:
      if ((raw >> (field.bits - 1) & 1U) != 0) {
        return static_cast<double>(raw) - std::ldexp(1.0, static_cast<int>(field.bits));
      }
      break;
    case ReportField::Type::kUnsigned:
      break;
  }
  return static_cast<double>(raw);
}

void putRaw(std::span<std::byte> report, const ReportField& field, double raw) noexcept {
  const double value = std::isfinite(raw) ? std::clamp(raw, field.least, field.most) : 0.0;
  std::uint32_t bits = 0;
  if (field.type == ReportField::Type::kFloat) {
    bits = std::bit_cast<std::uint32_t>(static_cast<float>(value));
  } else {
    bits = static_cast<std::uint32_t>(static_cast<std::int64_t>(std::llround(value)));
  }
  for (std::uint32_t k = 0; k < field.bits; ++k) {
    const BitPlace place = bitPlaceOf(field, k);
    const std::byte one = std::byte{1} << place.bit;
    std::byte& to = report[place.byte];
    to = (bits >> k & 1U) != 0 ? to | one : to & ~one;
  }
}

double Unwrapped::follow(double raw, std::uint32_t bits, double about) noexcept {
  const double range = std::ldexp(1.0, static_cast<int>(bits));
  if (known_) {
    if (raw - raw_ > 0.5 * range) turns_ -= range;
    if (raw - raw_ < -0.5 * range) turns_ += range;
  } else {
    turns_ = range * std::round((about - raw) / range);
  }
  known_ = true;
  raw_ = raw;
  return raw + turns_;
}

}  // namespace palpate
