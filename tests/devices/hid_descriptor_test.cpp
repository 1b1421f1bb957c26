/// Tests the parsing of report descriptors, and profiles that contradict a descriptor.
#include "palpate/devices/hid/hid_descriptor.h"

#include <cstdint>
#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "tests/devices/vm/vm_arm.h"
#include "tests/support/random.h"

namespace palpate::hid_descriptor_test {
using Catch::Contains;
using Way = DescribedReport::Way;

namespace {

std::vector<std::byte> bytes(const std::vector<int>& values) {
  std::vector<std::byte> out;
  for (const int v : values) out.push_back(static_cast<std::byte>(v));
  return out;
}

std::string text(const std::vector<std::byte>& descriptor) {
  const auto read = parseHidDescriptor(descriptor);
  if (!read) return "none";
  std::string out = read->numbered ? "#" : "";
  for (const DescribedReport& r : read->reports) {
    out += (r.way == Way::kInput    ? " in"
            : r.way == Way::kOutput ? " out"
                                    : " feature") +
           std::to_string(r.id) + ":" + std::to_string(r.size);
  }
  return out;
}

std::vector<std::byte> virtualArm() {
  const auto all = std::as_bytes(std::span(vm::kDescriptor));
  return {all.begin(), all.end()};
}

/// Descriptor of PJRC's RawHID: unnumbered reports of 64 bytes in both directions.
const std::vector<int> kRawHid{0x06, 0xAB, 0xFF, 0x0A, 0x00, 0x02, 0xA1, 0x01, 0x75, 0x08,
                               0x15, 0x00, 0x26, 0xFF, 0x00, 0x95, 64,   0x09, 0x01, 0x81,
                               0x02, 0x95, 64,   0x09, 0x02, 0x91, 0x02, 0xC0};

HidReportSpec report(std::optional<std::uint8_t> id, std::size_t size) {
  HidReportSpec out;
  out.id = id;
  out.size = size;
  return out;
}

HidStep feature(std::vector<std::byte> what) {
  HidStep step;
  step.kind = HidStep::Kind::kFeature;
  step.bytes = std::move(what);
  return step;
}

std::string complaint(const HidProfile& profile, const std::vector<std::byte>& device) {
  const auto read = parseHidDescriptor(device);
  REQUIRE(read);
  const auto said = complaintAbout(profile, *read);
  return said ? said->path + ": " + said->what + ": " + said->remedy : "none";
}

}  // namespace

TEST_CASE("a HID descriptor gives the direction, number and size of each report", "[hid]") {
  CHECK(text(virtualArm()) == "# in1:40 out2:24 feature3:8");
  CHECK(text(bytes(kRawHid)) == " in0:64 out0:64");
  // Tests a keyboard's lights (5 bits and 3 bits of padding), a report of 9 bits, a count that is
  // pushed and popped, and a report whose fields are declared in two places.
  CHECK(text(bytes({0x75, 1, 0x95, 5, 0x91, 2, 0x75, 3, 0x95, 1, 0x91, 1})) == " out0:1");
  CHECK(text(bytes({0x75, 1, 0x95, 9, 0x81, 2})) == " in0:2");
  CHECK(text(bytes({0x75, 8, 0x95, 2, 0xA4, 0x95, 4, 0x81, 2, 0xB4, 0x81, 2})) == " in0:6");
  CHECK(text(bytes({0x85, 9, 0x75, 8, 0x95, 1, 0x81, 2, 0x85, 7, 0x81, 2, 0x85, 9, 0x81, 2})) ==
        "# in9:2 in7:1");
  // Tests a size in four bytes with a count in two, a long item, which is skipped, and a report
  // without a number beside a numbered report, which is ignored.
  CHECK(text(bytes({0x77, 8, 0, 0, 0, 0x96, 0x2C, 0x01, 0x81, 2})) == " in0:300");
  CHECK(text(bytes({0xFE, 2, 0x10, 0x85, 0, 0x75, 8, 0x95, 1, 0xB1, 2})) == " feature0:1");
  CHECK(text(bytes({0x75, 8, 0x95, 1, 0x81, 2, 0x85, 4, 0x81, 2})) == "# in4:1");
}

TEST_CASE("a malformed HID descriptor is refused", "[hid]") {
  for (const std::vector<int>& none : std::vector<std::vector<int>>{
           {},
           {0x75},                                               // cut off
           {0x77, 8, 0},                                         // cut off
           {0xFE, 5, 0, 1},                                      // a long item, cut off
           {0xFE},                                               //
           {0x06, 0, 0xFF, 0xC0},                                // no report
           {0x75, 8, 0x95, 0, 0x81, 2},                          // an empty report
           {0xB4, 0x75, 8, 0x95, 1, 0x81, 2},                    // a pop without a push
           {0x85, 0, 0x75, 8, 0x95, 1, 0x81, 2},                 // the number 0
           {0x86, 0, 1, 0x75, 8, 0x95, 1, 0x81, 2},              // the number 256
           {0x77, 255, 255, 255, 255, 0x97, 255, 255, 255, 255,  //
            0x81, 2},                                            // a report of 2 EB
           {0x75, 8, 0x96, 0, 0x40, 0x81, 2, 0x95, 1, 0x81, 2},  // a report of 16 kB and 1 byte
       }) {
    CAPTURE(none);
    CHECK(text(bytes(none)) == "none");
  }
  CHECK(text(bytes({0x75, 8, 0x96, 0, 0x40, 0x81, 2})) == " in0:16384");
}

TEST_CASE("a HID descriptor gives the bits, range, usages and collections of each field", "[hid]") {
  const auto read = [](const std::vector<int>& values) {
    const auto descriptor = parseHidDescriptor(bytes(values));
    REQUIRE(descriptor);
    REQUIRE_FALSE(descriptor->fields.empty());
    return descriptor->fields;
  };
  // Two fields of 8 bits, then a field of 16 bits whose maximum precedes its minimum. A usage page
  // follows a usage.
  const auto fields =
      read({0x05, 0x01, 0x09, 0x04, 0xA1, 0x01, 0x09, 0x30, 0x05, 0x0F, 0x0B, 0x31, 0,
            1,    0,    0x15, 0,    0x25, 0xFF, 0x75, 8,    0x95, 2,    0x81, 2,    0x09,
            0x70, 0x26, 0xFF, 0x7F, 0x16, 0x01, 0x80, 0x55, 0x0D, 0x66, 3,    0x10, 0x75,
            16,   0x95, 1,    0x91, 6,    0x75, 8,    0xB1, 0,    0xC0, 0x81, 1});
  REQUIRE(fields.size() == 4);
  CHECK(fields[0].usage(0) == 0x0F0030);
  CHECK(fields[0].usage(1) == 0x010031);
  CHECK(fields[0].usage(2) == 0x010031);  // the last usage holds for all further fields
  CHECK(fields[0].most == 255);
  CHECK(fields[0].inside == std::vector<std::uint32_t>{0x010004});
  CHECK_FALSE(fields[0].array);
  CHECK(fields[1].way == Way::kOutput);
  CHECK(fields[1].bit == 0);
  CHECK(fields[1].least == -32767);
  CHECK(fields[1].most == 32767);
  CHECK(fields[1].exponent == -3);
  CHECK(fields[1].unit == 0x1003);
  CHECK(fields[1].relative);
  CHECK(fields[1].physical_most == 32767.0);
  CHECK(fields[2].array);
  CHECK(fields[2].usages.empty());  // usages belong to the previous field only
  CHECK(fields[3].constant);
  CHECK(fields[3].bit == 16);
  CHECK(fields[3].inside.empty());
  // Tests a range of usages and the index of a usage in this range.
  const auto range = read({0x05, 9, 0x19, 1, 0x29, 12, 0x75, 1, 0x95, 12, 0x81, 2})[0];
  CHECK(range.usage(11) == 0x09000C);
  CHECK(range.placeOf(0x090003) == 2U);
  CHECK_FALSE(range.placeOf(0x09000D));

  const auto nested = [&](int deep) {
    std::vector<int> all;
    for (int i = 0; i < deep; ++i) all.insert(all.end(), {0xA1, 1});
    all.insert(all.end(), {0x75, 8, 0x95, 1, 0x81, 2});
    return text(bytes(all));
  };
  CHECK(nested(32) == " in0:1");
  CHECK(nested(33) == "none");
  const auto used = [&](int count) {
    std::vector<int> all;
    for (int i = 0; i < count; ++i) all.insert(all.end(), {0x09, 1});
    all.insert(all.end(), {0x75, 8, 0x95, 1, 0x81, 2});
    return text(bytes(all));
  };
  CHECK(used(1024) == " in0:1");
  CHECK(used(1025) == "none");
  const auto many = [&](int count) {
    std::vector<int> all{0x75, 1, 0x95, 1};
    for (int i = 0; i < count; ++i) all.insert(all.end(), {0x81, 2});
    return text(bytes(all));
  };
  CHECK(many(1024) == " in0:128");
  CHECK(many(1025) == "none");
  CHECK(text(bytes({0xC0, 0x75, 8, 0x95, 1, 0x81, 2})) == "none");
}

TEST_CASE("mutated HID descriptors never crash the parser or give invalid reports", "[hid]") {
  test::Random random(7);
  const std::vector<std::vector<std::byte>> seeds{virtualArm(), bytes(kRawHid)};
  long read = 0;
  const long cases = test::cases(200000);
  const auto any = [&](std::size_t count) {
    return static_cast<std::size_t>(random.integer(static_cast<int>(count)));
  };
  for (long i = 0; i < cases; ++i) {
    std::vector<std::byte> all = seeds[any(seeds.size())];
    for (std::size_t k = 1 + any(6); k > 0; --k) {
      all[any(all.size())] = static_cast<std::byte>(any(256));
    }
    if (any(4) == 0) all.resize(any(all.size()));
    if (any(8) == 0) all.insert(all.end(), any(300), static_cast<std::byte>(any(256)));
    const auto descriptor = parseHidDescriptor(all);
    if (!descriptor) continue;
    ++read;
    for (const DescribedReport& r : descriptor->reports) {
      if (r.size > 0 && r.size <= 16384 && (r.id == 0) != descriptor->numbered) continue;
      CAPTURE(i, r.size, r.id, descriptor->numbered);
      FAIL("a report with an impossible size or number");
    }
  }
  CHECK(20 * read > cases - 100);
}

TEST_CASE("a mismatch between profile and HID descriptor is reported with its correction",
          "[hid]") {
  HidProfile arm;
  arm.input = {report(1, 40)};
  arm.output = report(2, 24);
  CHECK(complaint(arm, virtualArm()) == "none");
  arm.open = {feature(bytes({3, 0, 1})), feature(bytes({3, 1, 2, 3, 4, 5, 6, 7, 8}))};
  CHECK(complaint(arm, virtualArm()) == "none");

  // Without the report number, every field would be read one byte too early.
  arm.input[0].id.reset();
  CHECK(complaint(arm, virtualArm()) ==
        "/input/0: the device has input report 1 of 40 bytes, and this report has no number: write "
        "\"id\": 1");
  arm.input[0] = report(4, 40);
  CHECK(complaint(arm, virtualArm()) ==
        "/input/0: the device has input report 1 of 40 bytes, but no report 4: write \"id\": 1");
  arm.input[0] = report(1, 41);
  CHECK(complaint(arm, virtualArm()) ==
        "/input/0: the device's input report 1 has 40 bytes after its number, not 41: write "
        "\"size\": 40, and check the positions of its fields");
  arm.input[0] = report(1, 40);
  arm.output->size = 25;
  CHECK_THAT(complaint(arm, virtualArm()), Contains("/output: ") && Contains("\"size\": 24"));
  arm.output = report(1, 24);
  CHECK_THAT(complaint(arm, virtualArm()),
             Contains("output report 2 of 24 bytes, but no report 1: write \"id\": 2"));
  arm.output = report(2, 24);
  arm.open = {feature(bytes({5, 0, 1}))};
  CHECK_THAT(
      complaint(arm, virtualArm()),
      Contains("/open/0/feature: the device has feature report 3 of 8 bytes, but no report 5"));
  arm.open = {feature(bytes({3, 1, 2, 3, 4, 5, 6, 7, 8, 9}))};
  CHECK_THAT(complaint(arm, virtualArm()),
             Contains("8 bytes after its number, not 9: send at most 8 bytes"));

  // The profile numbers a report that the device does not number.
  arm.open.clear();
  CHECK(complaint(arm, bytes(kRawHid)) ==
        "/input/0: the device does not number its reports: remove every \"id\"");
  arm.input = {report(std::nullopt, 64)};
  arm.output = report(std::nullopt, 64);
  CHECK(complaint(arm, bytes(kRawHid)) == "none");
  arm.output->size = 14;
  CHECK_THAT(complaint(arm, bytes(kRawHid)), Contains("/output: the device's output report has 64 "
                                                      "bytes, not 14: write \"size\": 64"));
  arm.close = {feature(bytes({0, 1}))};
  arm.output->size = 64;
  CHECK_THAT(complaint(arm, bytes(kRawHid)),
             Contains("/close/0/feature: the device has no feature report"));

  // A profile of an arm without motors may ignore the end of a report, but must not read beyond it.
  HidProfile puck;
  puck.input = {report(1, 12)};
  CHECK(complaint(puck, virtualArm()) == "none");
  puck.input = {report(1, 41)};
  CHECK(complaint(puck, virtualArm()) != "none");
  // If there are many reports, the message lists only the first ones, in less than 250 characters.
  std::vector<int> many{0x75, 8, 0x95, 1};
  for (int id = 1; id <= 200; ++id) many.insert(many.end(), {0x85, id, 0x81, 2});
  puck.input = {report(std::nullopt, 1)};
  const std::string said = complaint(puck, bytes(many));
  CHECK_THAT(said,
             Contains("8 of 1 byte, ..., and this report has no number: write the number of"));
  CHECK(said.size() < 250);
}

}  // namespace palpate::hid_descriptor_test
