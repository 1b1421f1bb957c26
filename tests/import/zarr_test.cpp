#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/ome_zarr.h"
#include "palpate/scenes/apps/import/zarr_array.h"
#include "tests/support/vdb_files.h"

namespace palpate::zarr_test {
using Catch::Contains;
using importer::OmeImage;
using importer::ZarrLayout;
using Json = nlohmann::json;
namespace fs = std::filesystem;

Json arrayOf(const char* dtype, const Json& fill) {
  return {{"zarr_format", 2}, {"shape", {6, 5, 4}}, {"chunks", {2, 5, 4}},   {"dtype", dtype},
          {"order", "C"},     {"filters", nullptr}, {"compressor", nullptr}, {"fill_value", fill}};
}

template <class T>
T fillOf(const char* dtype, const Json& fill) {
  const ZarrLayout layout = importer::parseZarray(arrayOf(dtype, fill), "a/.zarray");
  T value{};
  std::memcpy(&value, layout.fill.data(), sizeof value);
  return value;
}

TEST_CASE("a Zarr fill value becomes a value of the array's type or is refused", "[zarr]") {
  CHECK(fillOf<std::uint8_t>("|u1", 255) == 255);
  CHECK(fillOf<std::int8_t>("|i1", -128) == -128);
  CHECK(fillOf<std::int64_t>(">i8", INT64_MIN) == INT64_MIN);
  CHECK(fillOf<std::uint64_t>("<u8", UINT64_MAX) == UINT64_MAX);
  CHECK(fillOf<std::uint16_t>(">u2", 3.0) == 3);
  CHECK(fillOf<std::uint8_t>("|b1", true) == 1);
  CHECK(fillOf<float>("<f4", -2.5) == -2.5F);
  CHECK(std::isnan(fillOf<float>(">f4", "NaN")));
  CHECK(fillOf<double>("<f8", "-Infinity") == -HUGE_VAL);
  CHECK(fillOf<double>("<f8", nullptr) == 0.0);
  const auto refuses = [](const char* dtype, const Json& fill) {
    CAPTURE(dtype, fill.dump());
    CHECK_THROWS_WITH(importer::parseZarray(arrayOf(dtype, fill), "a/.zarray"),
                      Contains("a/.zarray: \"fill_value\" is " + fill.dump()));
  };
  refuses("|u1", 256);
  refuses("|u1", -1);
  refuses("|i1", -129);
  refuses("<i4", 2.5);
  refuses("<i4", "NaN");
  refuses("<i8", UINT64_MAX);
  refuses("<f4", "many");
  Json nested = 1;
  for (int n = 0; n < 50; ++n) nested = Json::array({nested});
  CHECK_THROWS_WITH(importer::parseZarray(arrayOf("<f4", nested), "a/.zarray"),
                    Contains("\"fill_value\" is a structure, which is not a value"));
}

TEST_CASE("the chunk files of a Zarr array are checked once for each box of values", "[zarr]") {
  const test::TemporaryFolder folder;
  std::ofstream(folder / ".zarray") << arrayOf("|u1", 9);
  std::ofstream(folder / "0.0.0") << std::string(40, '\5');
  importer::Request request;
  request.file = folder.path();
  importer::ZarrArray array(request, folder.path());
  const importer::ZarrBox whole{{0, 0, 0}, {6, 5, 4}};
  (void)array.read(whole, whole, nullptr);
  std::ofstream(folder / "1.0.0") << "too small";
  CHECK(array.read(whole, whole, nullptr).at(50, 0) == 9.0);
  CHECK(array.checkedChunks() == 6);
  CHECK(array.missingChunks() == 4);
  // Another box is checked.
  CHECK_THROWS_WITH(array.read({{0, 0, 0}, {4, 5, 4}}, {{0, 0, 0}, {1, 5, 4}}, nullptr),
                    Contains("1.0.0"));
}

TEST_CASE("the error for a Zarr array of too many values names the options that help", "[zarr]") {
  const test::TemporaryFolder folder;
  Json json = arrayOf("|u1", 9);
  json["shape"] = {2000, 2000, 2000};
  json["chunks"] = {1000, 1000, 1000};
  std::ofstream(folder / ".zarray") << json;
  importer::Request request;
  const importer::ZarrBox whole{{0, 0, 0}, {2000, 2000, 2000}};
  const auto message = [&](bool has_coarser) -> std::string {
    importer::ZarrArray array(request, folder.path(), has_coarser);
    try {
      (void)array.read(whole, whole, nullptr);
    } catch (const VolumeError& e) {
      return e.what();
    }
    return "";
  };
  CHECK_THAT(message(false), Contains("add --bricks") && !Contains("--level"));
  CHECK_THAT(message(true), Contains("add --bricks") && Contains("or choose a coarser level"));
  // The limit does not apply to a caller that asks for slices. The missing files are found next.
  request.slices = [](const std::array<int, 3>&, const importer::Affine&, bool, int) {
    return importer::Slab{};
  };
  CHECK_THAT(message(false), Contains("has only 0 of its 8 chunks"));
}

TEST_CASE("metadata of Zarr that are nested too deeply are refused", "[zarr]") {
  const test::TemporaryFolder folder;
  const fs::path file = folder / ".zattrs";
  const auto write = [&](std::size_t depth) {
    std::ofstream(file) << "{\"a\": " << std::string(depth, '[') << std::string(depth, ']') << "}";
  };
  write(60);
  CHECK(importer::readZarrJson(file).contains("a"));
  write(1'000'000);
  CHECK_THROWS_WITH(importer::readZarrJson(file), Contains("have more than 64 levels"));
}

TEST_CASE("reading a part of a Zarr array opens only the chunks of this part", "[zarr]") {
  const test::TemporaryFolder folder;
  Json json = arrayOf("|u1", 9);
  json["compressor"] = {{"id", "zstd"}};
  std::ofstream(folder / ".zarray") << json;
  // Chunk 0 is damaged, chunk 1 is missing, and chunk 2 is one block of 40 equal bytes.
  std::ofstream(folder / "0.0.0") << "damaged chunk";
  const unsigned char zstd[] = {0x28, 0xb5, 0x2f, 0xfd, 0x20, 40, 0x43, 0x01, 0x00, 5};
  std::ofstream(folder / "2.0.0", std::ios::binary)
      .write(reinterpret_cast<const char*>(zstd), sizeof zstd);

  importer::Request request;
  request.file = folder.path();
  importer::ZarrArray array(request, folder.path());
  const importer::ZarrBox whole{{0, 0, 0}, {6, 5, 4}};
  const importer::Values values = array.read(whole, {{3, 1, 0}, {3, 2, 4}}, nullptr);
  REQUIRE(values.tuples() == 24);
  for (std::size_t n = 0; n < 24; ++n) CHECK(values.at(n, 0) == (n < 8 ? 9.0 : 5.0));
  CHECK(array.missingChunks() == 1);
  CHECK(array.checkedChunks() == 3);
  CHECK(array.read(whole, {{6, 0, 0}, {0, 5, 4}}, nullptr).tuples() == 0);
  CHECK_THROWS_WITH(array.read(whole, whole, nullptr), Contains("the chunk 0.0.0 is damaged"));
}

Json imageOf(const Json& axes, const Json& transformations) {
  const Json level{{"path", "0"}, {"coordinateTransformations", transformations}};
  return {{"multiscales", {{{"axes", axes}, {"datasets", {level}}}}}};
}

TEST_CASE("axes of an OME-Zarr image are found by name, else the last is x", "[zarr]") {
  const auto axis = [](const char* name, const char* type) {
    const bool is_time = std::string(type) == "time";
    return Json{{"name", name}, {"type", type}, {"unit", is_time ? "second" : "micrometer"}};
  };
  const Json scale = Json::array({{{"type", "scale"}, {"scale", {1, 2, 3, 4}}}});
  std::vector<std::string> notes;
  const OmeImage named = importer::parseOmeImage(
      imageOf({axis("c", "channel"), axis("y", "space"), axis("x", "space"), axis("z", "space")},
              scale),
      ".zattrs", notes);
  CHECK(named.space == std::array<std::size_t, 3>{2, 1, 3});
  CHECK(named.channel == 0);
  CHECK(named.time == -1);
  CHECK(named.unit == "um");
  CHECK(named.levels.at(0).scale == std::vector<double>{1, 2, 3, 4});
  CHECK(notes.empty());
  const OmeImage other = importer::parseOmeImage(
      imageOf({axis("w", "time"), axis("a", "space"), axis("b", "space"), axis("d", "space")},
              scale),
      ".zattrs", notes);
  CHECK(other.space == std::array<std::size_t, 3>{3, 2, 1});
  CHECK(other.time == 0);
  CHECK(other.time_unit == "second");
  CHECK_THAT(notes.at(0), Contains("the axes in space are a, b and d"));
}

}  // namespace palpate::zarr_test
