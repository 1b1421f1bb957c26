/// Tests the conversion of report bytes to numbers and back.
#include "palpate/devices/hid/hid_report.h"

#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <vector>

#include <catch2/catch.hpp>

#include "tests/support/random.h"

namespace palpate::hid_report_test {
using palpate::test::Random;

namespace {

std::vector<std::byte> bytes(std::initializer_list<int> values) {
  std::vector<std::byte> out;
  for (const int v : values) out.push_back(static_cast<std::byte>(v));
  return out;
}

ReportField field(std::uint32_t bit, std::uint32_t bits, ReportField::Type type) {
  ReportField f;
  f.bit = bit;
  f.bits = bits;
  f.type = type;
  const double span = std::ldexp(1.0, static_cast<int>(bits));
  f.least = type == ReportField::Type::kSigned ? -0.5 * span : 0.0;
  f.most = type == ReportField::Type::kSigned ? 0.5 * span - 1.0 : span - 1.0;
  if (type == ReportField::Type::kFloat) {
    f.least = -3e38;
    f.most = 3e38;
  }
  return f;
}

}  // namespace

TEST_CASE("fields of a HID report are decoded at their bit positions", "[hid]") {
  using Type = ReportField::Type;
  const auto report = bytes({0x34, 0x12, 0xFE, 0xFF, 0xA5});
  CHECK(rawOf(report, field(0, 16, Type::kUnsigned)) == 0x1234);
  CHECK(rawOf(report, field(16, 16, Type::kSigned)) == -2);
  CHECK(rawOf(report, field(16, 16, Type::kUnsigned)) == 65534);
  CHECK(rawOf(report, field(32, 3, Type::kUnsigned)) == 5);
  CHECK(rawOf(report, field(35, 5, Type::kSigned)) == -12);
  CHECK(rawOf(report, field(4, 8, Type::kUnsigned)) == 0x23);
  ReportField big = field(0, 16, Type::kUnsigned);
  big.big_endian = true;
  CHECK(rawOf(report, big) == 0x3412);
  const auto pi = std::bit_cast<std::array<std::byte, 4>>(3.25F);
  CHECK(rawOf(pi, field(0, 32, Type::kFloat)) == 3.25);
}

TEST_CASE("writing a field of a HID report changes only the bits of this field", "[hid]") {
  Random random(1);
  using Type = ReportField::Type;
  for (long i = 0; i < test::cases(20000); ++i) {
    const std::array types{Type::kUnsigned, Type::kSigned, Type::kFloat};
    const Type type = types[static_cast<std::size_t>(random.integer(3))];
    ReportField f =
        field(0, type == Type::kFloat ? 32U : 1U + static_cast<unsigned>(random.integer(32)), type);
    f.big_endian = random.integer(3) == 0;
    if (f.big_endian && type != Type::kFloat)
      f.bits = 8U * (1U + static_cast<unsigned>(random.integer(4)));
    f = [&] {
      ReportField g = field(0, f.bits, type);
      g.big_endian = f.big_endian;
      return g;
    }();
    const int room = 64 - static_cast<int>(f.bits);
    f.bit = static_cast<std::uint32_t>(random.integer(room + 1));
    if (f.big_endian) f.bit -= f.bit % 8;
    std::vector<std::byte> report(8);
    for (std::byte& b : report) b = static_cast<std::byte>(random.integer(256));
    const std::vector<std::byte> before = report;
    const double value = type == Type::kFloat
                             ? static_cast<double>(static_cast<float>(random.uniform(-1e6, 1e6)))
                             : std::floor(random.uniform(f.least, f.most + 1.0));
    putRaw(report, f, value);
    REQUIRE(rawOf(report, f) == value);
    // Writing must not change the bits of other fields.
    putRaw(report, f, 0.0);
    double changed = 0.0;
    for (std::uint32_t b = 0; b < 64; ++b) {
      const bool ours =
          f.big_endian ? b / 8 >= f.bit / 8 && b / 8 < f.end() : b >= f.bit && b < f.bit + f.bits;
      ReportField one = field(b, 1, Type::kUnsigned);
      if (!ours) changed += std::abs(rawOf(report, one) - rawOf(before, one));
    }
    REQUIRE(changed == 0.0);
  }
}

TEST_CASE("a HID report field gets a value limited to its range, and 0 if the value is not finite",
          "[hid]") {
  ReportField f = field(0, 16, ReportField::Type::kSigned);
  f.least = -3000;
  f.most = 2000;
  std::vector<std::byte> report(2);
  for (const auto& [in, out] : std::vector<std::pair<double, double>>{
           {1e9, 2000}, {-1e9, -3000}, {0.4, 0}, {-0.6, -1}, {INFINITY, 0}, {std::nan(""), 0}}) {
    putRaw(report, f, in);
    CHECK(rawOf(report, f) == out);
  }
}

TEST_CASE("the decoder of HID reports unwraps a counter that overflows or underflows", "[hid]") {
  for (const std::uint32_t bits : {8U, 16U, 24U, 32U}) {
    Random random(bits);
    const double range = std::ldexp(1.0, static_cast<int>(bits));
    Unwrapped counter;
    double truth = random.uniform(0.0, 1.0) > 0.5 ? 5.0 : range - 7.0;
    const bool with_sign = random.integer(2) == 0;
    if (with_sign && truth > 0.5 * range) truth -= range;
    for (int i = 0; i < 10000; ++i) {
      // The device counts modulo its range, signed or unsigned.
      double raw = truth - range * std::floor(truth / range);
      if (with_sign && raw >= 0.5 * range) raw -= range;
      REQUIRE(counter.follow(raw, bits, 0.0) == truth);
      truth += std::floor(random.uniform(-0.4, 0.45) * range);
    }
    CHECK(std::abs(truth) > 10.0 * range);
  }
}

}  // namespace palpate::hid_report_test
