// Tests that an image gives the same bricks if it is imported slab by slab.
#include "palpate/scenes/apps/import/slab_group.h"

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>
#include <vector>

#include <catch2/catch.hpp>
#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/importer.h"
#include "palpate/scenes/apps/import/report.h"
#include "tests/support/thread_group.h"
#include "tests/support/vdb_files.h"

namespace palpate::slab_group_test {
using namespace palpate::importer;

namespace {

namespace fs = std::filesystem;
using Files = std::map<std::string, std::string>;

constexpr std::array<int, 3> kSize{30, 26, 250};  // 4 layers of bricks, the last one incomplete
/// Limit of the points in a slab. It is so small that each slab has a single layer.
constexpr double kOneLayer = 1.0;

Files filesIn(const fs::path& folder) {
  Files files;
  for (const auto& one : fs::recursive_directory_iterator(folder)) {
    if (!one.is_regular_file()) continue;
    std::ifstream file(one.path(), std::ios::binary);
    files[one.path().lexically_relative(folder).string()] = {std::istreambuf_iterator<char>(file),
                                                             {}};
  }
  return files;
}

/// Returns a rod along k, which ends within the last layer. Its values vary everywhere.
std::vector<float> rod() {
  std::vector<float> values;
  for (int k = 0; k < kSize[2]; ++k) {
    const double x = 14.0 + 6.0 * std::sin(k / 17.0);
    const double y = 12.0 + 5.0 * std::cos(k / 23.0);
    for (int j = 0; j < kSize[1]; ++j) {
      for (int i = 0; i < kSize[0]; ++i) {
        const double near = 60.0 - (i - x) * (i - x) - (j - y) * (j - y);
        const bool within = near > 0.0 && k < 210;
        values.push_back(within ? static_cast<float>(near + 0.1 * ((7 * i + 11 * j + 13 * k) % 31))
                                : 0.0F);
      }
    }
  }
  return values;
}

template <class T>
std::vector<T> rodAs(double offset = 0.0) {
  std::vector<T> values;
  for (const float v : rod()) values.push_back(static_cast<T>(static_cast<double>(v) + offset));
  return values;
}

template <class T>
std::string bytesOf(const std::vector<T>& values) {
  return {reinterpret_cast<const char*>(values.data()), sizeof(T) * values.size()};
}

/// Returns a TIFF of 16-bit pages without compression, one for each slice.
std::string tiffOf(const std::vector<std::uint16_t>& values) {
  constexpr std::size_t kPlane = std::size_t{kSize[0]} * kSize[1];
  constexpr std::uint32_t kTags = 8;
  constexpr std::uint32_t kDirectory = 2 + 12 * kTags + 4;
  std::string out("II*\0", 4);
  const auto put = [&](auto value) {
    out.append(reinterpret_cast<const char*>(&value), sizeof(value));
  };
  put(std::uint32_t{8});
  for (std::size_t k = 0; k < values.size() / kPlane; ++k) {
    const auto data = static_cast<std::uint32_t>(out.size()) + kDirectory;
    const auto bytes = static_cast<std::uint32_t>(2 * kPlane);
    put(static_cast<std::uint16_t>(kTags));
    const std::array<std::array<std::uint32_t, 2>, kTags> tags{{{256, kSize[0]},
                                                                {257, kSize[1]},
                                                                {258, 16},
                                                                {259, 1},
                                                                {262, 1},
                                                                {273, data},
                                                                {278, kSize[1]},
                                                                {279, bytes}}};
    for (const auto& [tag, value] : tags) {
      put(static_cast<std::uint16_t>(tag));
      put(std::uint16_t{4});  // LONG
      put(std::uint32_t{1});
      put(value);
    }
    put((k + 1) * kPlane < values.size() ? data + bytes : std::uint32_t{0});
    out.append(reinterpret_cast<const char*>(&values[k * kPlane]), bytes);
  }
  return out;
}

/// Writes a Zarr array of bytes. Leaves out the chunk `missing`.
void writeZarr(const fs::path& folder, const std::vector<std::uint8_t>& values, int depth,
               int missing) {
  fs::create_directory(folder);
  std::ofstream(folder / ".zarray") << fmt::format(
      R"({{"zarr_format": 2, "shape": [{2}, {1}, {0}], "chunks": [{3}, {1}, {0}], "dtype": "|u1",)"
      R"("order": "C", "filters": null, "compressor": null, "fill_value": 7}})",
      kSize[0], kSize[1], kSize[2], depth);
  const std::string bytes = bytesOf(values);
  const std::size_t each = std::size_t{kSize[0]} * kSize[1] * static_cast<std::size_t>(depth);
  for (std::size_t n = 0; n * each < bytes.size(); ++n) {
    if (static_cast<int>(n) == missing) continue;
    std::string chunk = bytes.substr(n * each, each);
    chunk.resize(each);
    std::ofstream(folder / fmt::format("{}.0.0", n), std::ios::binary) << chunk;
  }
}

struct Result {
  bool divided = false;
  std::string report;
  Files files;  ///< Empty if the image is constant.
};

/// Imports the first step. `progress` receives the progress of the writing.
Result import(const Options& options, const fs::path& out, double most_points,
              const Progress& progress = nullptr) {
  openvdb::initialize();
  SingleProcess alone;
  SlabGroup group(alone, most_points);
  const Telling telling{[](const std::string&) {}, nullptr};
  const auto reader = openFor(options, telling, group);
  EarlierSteps earlier;
  Step step = importStep(options, *reader, 0, telling, group, earlier);
  Result result;
  auto report = jsonOf("out", step);
  report.erase("memory");
  result.report = report.dump();
  if (!step.grids.empty()) {
    writeAsBricks(out, step, progress, alone);
    result.files = filesIn(out);
  }
  result.divided = group.isDivided();
  return result;
}

struct Fixture {
  test::TemporaryFolder folder;
  Options options;

  Fixture() { options.bricks = true; }

  void write(const std::string& name, const std::string& bytes) {
    options.request.file = folder / name;
    std::ofstream(options.request.file, std::ios::binary) << bytes;
  }
  void raw(const char* type, const std::string& bytes, int components = 1) {
    write("values.raw", bytes);
    options.request.raw = fmt::format(
        R"({{"size": [{}, {}, {}], "type": "{}", "components": {}, "spacing": [1, 1, 0.75]}})",
        kSize[0], kSize[1], kSize[2], type, components);
  }
  /// Checks that slabs of one and of two layers give the same files and the same report as the
  /// whole image. A smoothed image is divided only into slabs of one layer. Returns the report.
  std::string check() const {
    const Result whole = import(options, folder / "whole", 1e9);
    CHECK_FALSE(whole.divided);
    for (const double layers : {0.9, 2.0}) {
      const Result slabs = import(options, folder / fmt::format("slabs{}", layers),
                                  layers * kSize[0] * kSize[1] * kBrickSide);
      CAPTURE(layers, whole.report);
      CHECK(slabs.divided == (layers < 1.0 || options.smooth.sigma == 0.0));
      CHECK(slabs.report == whole.report);
      CHECK(slabs.files == whole.files);
    }
    return whole.report;
  }
};

}  // namespace

TEST_CASE("a process that works on slabs in turn gathers the same bytes as a process group",
          "[import][process_group]") {
  const auto work = [](ProcessGroup& group) {
    const std::vector<int> own(static_cast<std::size_t>(group.rank()), group.rank());
    const std::vector<int> ranks = gatherOne(group, 10 * group.rank());
    std::vector<int> all = gatherAll(group, own);
    all.insert(all.end(), ranks.begin(), ranks.end());
    return all;
  };
  std::vector<int> expected;
  CHECK(test::byThreads(3, [&](ProcessGroup& group) {
          const std::vector<int> all = work(group);
          if (group.rank() == 0) expected = all;
        }) == 0);
  CHECK(expected == std::vector<int>{1, 2, 2, 0, 10, 20});

  SingleProcess alone;
  SlabGroup group(alone, kOneLayer);
  int begun = 0;
  const auto by_slabs = [&] {
    ++begun;
    group.divide({2, 2, 3 * kBrickSide});
    return std::pair(group.rank(), work(group));
  };
  std::vector<int> turns;
  CHECK(group.run(by_slabs, [&](int pass) { turns.push_back(10 * pass + group.rank()); }) ==
        std::pair(0, expected));
  CHECK(group.size() == 3);
  // The first rank of the first pass divides the group.
  CHECK(turns == std::vector<int>{1, 2, 10, 11, 12, 20});
  CHECK(begun == 7);
  CHECK(group.runAgain(2, by_slabs) == std::pair(2, expected));
  CHECK(group.sharesOf(3).size() == 3);
  CHECK(group.sharesOf(3)[2].first == 2);
}

TEST_CASE("a reduction over all slabs is computed once and is known after the first pass",
          "[import][process_group]") {
  static int computed = 0;
  computed = 0;
  SingleProcess alone;
  SlabGroup group(alone, kOneLayer);
  std::vector<char> known;
  const auto work = [&] {
    group.divide({2, 2, 2 * kBrickSide});
    known.push_back(static_cast<char>(group.isKnown()));
    const double sum = group.reduced(
        std::vector<int>{5 + group.rank()}, +[](std::vector<int> all) {
          ++computed;
          return all.at(0) + 0.5 * all.at(1);
        });
    (void)gatherOne(group, 0);
    return sum;
  };
  CHECK(group.run(work, [](int) {}) == 8.0);
  CHECK(group.runAgain(1, work) == 8.0);
  CHECK(computed == 1);
  CHECK(known == std::vector<char>{0, 0, 1, 1, 1, 1});
}

TEST_CASE("an image whose slices are decoded together is divided into fewer slabs",
          "[import][process_group]") {
  const auto slabs = [](int slices, int depth, double most_layers) {
    SingleProcess alone;
    SlabGroup group(alone, most_layers * 2 * 2 * kBrickSide);
    group.divide({2, 2, slices}, /*is_slow=*/false, depth);
    return group.size();
  };
  CHECK(slabs(640, 1, 1.0) == 10);
  CHECK(slabs(640, 8, 1.0) == 10);
  CHECK(slabs(640, 64, 1.0) == 5);      // two layers each: a pass decodes at most 10 + 8 layers
  CHECK(slabs(640, 640, 8.0) == 1);     // the whole image is at most four slabs
  CHECK(slabs(6400, 6400, 1.0) == 25);  // but a slab has at most four times the points
  CHECK(slabs(640, 64, 0.1) == 10);
}

TEST_CASE("several arrays for bricks are refused before the first array is imported",
          "[import][bricks]") {
  Fixture fixture;
  fixture.options.request.file = fixture.folder / "two.zarr";
  fs::create_directories(fixture.options.request.file / "0");
  std::ofstream(fixture.options.request.file / ".zattrs") << R"({"multiscales": [{"axes": [
    {"name": "c", "type": "channel"}, {"name": "z", "type": "space"},
    {"name": "y", "type": "space"}, {"name": "x", "type": "space"}],
    "datasets": [{"path": "0", "coordinateTransformations": [
      {"type": "scale", "scale": [1, 1, 1, 1]}]}]}]})";
  std::ofstream(fixture.options.request.file / "0/.zarray")
      << R"({"zarr_format": 2, "shape": [2, 250, 2, 2], "chunks": [1, 250, 2, 2], "dtype": "|u1",
             "order": "C", "filters": null, "compressor": null, "fill_value": 7})";
  for (const char* chunk : {"0.0.0.0", "1.0.0.0"}) {
    std::string bytes(1000, '\1');
    bytes[500] = '\3';
    std::ofstream(fixture.options.request.file / "0" / chunk) << bytes;
  }
  openvdb::initialize();
  SingleProcess alone;
  SlabGroup group(alone, kOneLayer);
  std::vector<std::string> stages;
  const Telling telling{[&](const std::string& stage) { stages.push_back(stage); }, nullptr};
  const auto reader = openFor(fixture.options, telling, group);
  EarlierSteps earlier;
  CHECK_THROWS_WITH(importStep(fixture.options, *reader, 0, telling, group, earlier),
                    Catch::Contains("2 arrays are imported, and --bricks writes only one: "
                                    "channel_0, channel_1") &&
                        Catch::Contains("choose one with --field"));
  CHECK(stages == std::vector<std::string>{"reading"});
  fixture.options.request.fields = {"channel_1"};
  const Result one = import(fixture.options, fixture.folder / "one", 1e9);
  CHECK(one.files.count("palpate.bricks") == 1);
}

TEST_CASE("an error in one slab ends the work of a process that works on slabs in turn",
          "[import][process_group]") {
  SingleProcess alone;
  SlabGroup group(alone, kOneLayer);
  const auto work = [&] {
    group.divide({2, 2, 3 * kBrickSide});
    if (group.rank() == 1) throw std::runtime_error("the second slab");
    return gatherOne(group, 0);
  };
  CHECK_THROWS_WITH(group.run(work, [](int) {}), "the second slab");
}

TEST_CASE("floats imported slab by slab give the same bricks as the whole image",
          "[import][bricks][process_group]") {
  Fixture fixture;
  SECTION("without options") {
    fixture.raw("float32", bytesOf(rod()));
  }
  SECTION("with a tolerance") {
    fixture.raw("float32", bytesOf(rod()));
    fixture.options.tolerance = 3.0;
  }
  SECTION("smoothed") {
    fixture.raw("float32", bytesOf(rod()));
    fixture.options.smooth = {2.5, /*in_file_units=*/true};
  }
  SECTION("with voxels without data, some of them beside another slab") {
    std::vector<float> values = rod();
    const std::size_t slice = std::size_t{30} * 26;
    for (const std::size_t k : {std::size_t{63}, std::size_t{64}, std::size_t{190}}) {
      values[k * slice + 13 * 30 + 14] = std::numeric_limits<float>::quiet_NaN();
    }
    fixture.raw("float32", bytesOf(values));
  }
  SECTION("vectors, smoothed") {
    std::vector<float> values = rod();
    const std::vector<float> once = values;
    for (int c = 1; c < 3; ++c) values.insert(values.end(), once.rbegin(), once.rend());
    fixture.raw("float32", bytesOf(values), 3);
    fixture.options.smooth = {1.0, true};
  }
  SECTION("vectors of one value") {
    fixture.raw("float32", bytesOf(std::vector<float>(3 * rod().size(), 2.0F)), 3);
  }
  (void)fixture.check();
}

TEST_CASE("whole numbers imported slab by slab give the same bricks as the whole image",
          "[import][bricks][process_group]") {
  Fixture fixture;
  SECTION("bytes") {
    fixture.raw("uint8", bytesOf(rodAs<std::uint8_t>()));
  }
  SECTION("with a fill value in the last slab") {
    auto values = rodAs<std::int16_t>();
    values[values.size() - 5] = std::numeric_limits<std::int16_t>::min();
    fixture.raw("int16", bytesOf(values));
    CHECK_THAT(fixture.check(), Catch::Contains("counts as missing data"));
    return;
  }
  SECTION("with a whole number in the last slab that a float cannot hold") {
    auto values = rodAs<std::int32_t>();
    values[values.size() - 5] = (1 << 25) + 1;
    fixture.raw("int32", bytesOf(values));
    CHECK_THAT(fixture.check(), Catch::Contains("above 16,777,216 may be rounded"));
    return;
  }
  SECTION("with an offset") {
    fixture.raw("int32", bytesOf(rodAs<std::int32_t>(1e8)));
    CHECK_THAT(fixture.check(), Catch::Contains("value_offset"));
    return;
  }
  (void)fixture.check();
}

TEST_CASE("files with headers imported slab by slab give the same bricks as the whole image",
          "[import][bricks][process_group]") {
  Fixture fixture;
  SECTION("MetaImage") {
    fixture.write("rod.mha",
                  "ObjectType = Image\nNDims = 3\nDimSize = 30 26 250\nElementSpacing = 1 1 2\n"
                  "ElementType = MET_FLOAT\nElementToIntensityFunctionSlope = 0.3\n"
                  "ElementDataFile = LOCAL\n" +
                      bytesOf(rod()));
  }
  SECTION("NIfTI") {
    std::string header(352, '\0');
    const auto put = [&](std::size_t at, auto value) {
      std::memcpy(header.data() + at, &value, sizeof(value));
    };
    put(0, std::int32_t{348});
    const std::array<std::int16_t, 8> size{3, 30, 26, 250, 1, 1, 1, 1};
    put(40, size);
    put(70, std::int16_t{16});
    put(72, std::int16_t{32});
    put(76, std::array<float, 4>{1.0F, 1.0F, 1.0F, 1.0F});
    put(108, 352.0F);
    std::memcpy(header.data() + 344, "n+1", 4);
    fixture.write("rod.nii", header + bytesOf(rod()));
  }
  SECTION("Zarr with a missing chunk") {
    fixture.options.request.file = fixture.folder / "rod.zarr";
    writeZarr(fixture.options.request.file, rodAs<std::uint8_t>(), 20, 4);
    CHECK_THAT(fixture.check(), Catch::Contains("1 of 13 chunks are missing"));
    return;
  }
  SECTION("TIFF with pages") {
    fixture.write("rod.tif", tiffOf(rodAs<std::uint16_t>()));
    fixture.options.request.spacing = Spacing{Vec3(1.0, 1.0, 2.0), "mm"};
  }
  (void)fixture.check();
}

TEST_CASE("an image of one value is skipped with the same note if imported slab by slab",
          "[import][bricks][process_group]") {
  Fixture fixture;
  fixture.raw("uint8", std::string(rod().size(), '\7'));
  CHECK_THAT(fixture.check(), Catch::Contains("all voxels have the same value"));
  CHECK_FALSE(fs::exists(fixture.folder / "whole"));
  CHECK_FALSE(fs::exists(fixture.folder / "slabs2"));
}

TEST_CASE("an interrupted import by slabs has no manifest, and the next import completes it",
          "[import][bricks][process_group]") {
  Fixture fixture;
  fixture.raw("float32", bytesOf(rod()));
  const Result whole = import(fixture.options, fixture.folder / "whole", 1e9);
  const fs::path out = fixture.folder / "slabs";
  for (const double end : {0.3, 0.6, 0.9}) {
    const auto stop = [&](double done) {
      if (done > end) throw std::runtime_error("stop");
    };
    CHECK_THROWS_WITH(import(fixture.options, out, kOneLayer, stop), "stop");
    CHECK(fs::exists(out / "0"));
    CHECK_FALSE(fs::exists(out / "palpate.bricks"));
  }
  CHECK(import(fixture.options, out, kOneLayer).files == whole.files);
  CHECK(whole.files.count("palpate.bricks") == 1);
}

TEST_CASE("a raw file that is shorter than its layout states is refused without an output",
          "[import][bricks][process_group]") {
  Fixture fixture;
  fixture.raw("float32", bytesOf(rod()).substr(4));
  CHECK_THROWS_AS(import(fixture.options, fixture.folder / "out", kOneLayer), VolumeError);
  CHECK_FALSE(fs::exists(fixture.folder / "out"));
}

}  // namespace palpate::slab_group_test
