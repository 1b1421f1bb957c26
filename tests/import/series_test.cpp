// Tests that time steps are read from NRRD, NIfTI and MetaImage files. In NRRD, any axis may be
// time.
#include <cstring>
#include <filesystem>
#include <fstream>
#include <unistd.h>

#include <catch2/catch.hpp>
#include <fmt/format.h>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::series_test {
using namespace palpate::importer;

namespace {

constexpr int kSteps = 3;
constexpr int kPoints = 2 * 3 * 4;

/// A temporary folder, removed by the destructor.
class Folder {
 public:
  Folder() : path_(std::filesystem::temp_directory_path() / fmt::format("series_{}", getpid())) {
    std::filesystem::create_directory(path_);
  }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  ~Folder() { std::filesystem::remove_all(path_); }

  /// Writes a header and 16-bit values. Returns a request to import the file.
  Request write(const std::string& name, const std::string& header,
                const std::vector<std::int16_t>& values) const {
    std::ofstream out(path_ / name, std::ios::binary);
    out << header;
    out.write(reinterpret_cast<const char*>(values.data()),
              static_cast<std::streamsize>(2 * values.size()));
    Request request;
    request.file = path_ / name;
    return request;
  }

 private:
  std::filesystem::path path_;
};

std::int16_t valueAt(int step, int point, int component = 0) {
  return static_cast<std::int16_t>(1000 * step + 10 * point + component);
}

void checkSteps(Reader& reader, int components = 1, Type type = Type::kInt16) {
  REQUIRE(reader.times().size() == kSteps);
  for (const int step : {2, 0, 1, 1}) {  // steps in any order, also repeated
    const Content content = reader.read(static_cast<std::size_t>(step));
    REQUIRE(content.pieces.size() == 1);
    REQUIRE(content.pieces[0].isImage());
    const Values& values = content.pieces[0].arrays.at(0).values;
    REQUIRE(values.tuples() == kPoints);
    REQUIRE(values.components() == components);
    CHECK(values.type() == type);
    for (int point = 0; point < kPoints; ++point) {
      for (int c = 0; c < components; ++c) {
        CHECK(values.at(static_cast<std::size_t>(point), c) == valueAt(step, point, c));
      }
    }
  }
}

std::string nrrd(const std::string& sizes, const std::string& fields) {
  return fmt::format(
      "NRRD0005\ntype: short\ndimension: {}\nsizes: {}\nencoding: raw\nendian: little\n{}",
      1 + std::count(sizes.begin(), sizes.end(), ' '), sizes, fields);
}

std::string nifti(const std::vector<std::int16_t>& dims, float step) {
  std::string header(352, '\0');
  const auto put = [&](std::size_t at, auto value) {
    std::memcpy(header.data() + at, &value, sizeof(value));
  };
  put(0, std::int32_t{348});
  put(40, static_cast<std::int16_t>(dims.size()));
  for (std::size_t i = 0; i < dims.size(); ++i) put(42 + 2 * i, dims[i]);
  put(70, std::int16_t{4});
  put(72, std::int16_t{16});
  for (std::size_t i = 0; i < 4; ++i) put(76 + 4 * i, 1.0F);
  put(92, step);
  put(108, 352.0F);
  std::memcpy(header.data() + 344, "n+1", 4);
  return header;
}

}  // namespace

TEST_CASE("the time steps of an NRRD file are read for every position of the time axis",
          "[series]") {
  const Folder folder;
  std::vector<std::int16_t> last;
  std::vector<std::int16_t> first;
  std::vector<std::int16_t> between;  // axes: component, time, space
  for (int s = 0; s < kSteps; ++s) {
    for (int p = 0; p < kPoints; ++p) last.push_back(valueAt(s, p));
  }
  for (int p = 0; p < kPoints; ++p) {
    for (int s = 0; s < kSteps; ++s) {
      first.push_back(valueAt(s, p));
      for (int c = 0; c < 3; ++c) between.push_back(valueAt(s, p, c));
    }
  }
  SECTION("the time axis is last") {
    auto reader = openNrrd(folder.write(
        "a.nrrd", nrrd("2 3 4 3", "kinds: space space space time\nspacings: 1 1 1 0.25\n\n"),
        last));
    checkSteps(*reader);
    CHECK(reader->times() == std::vector<double>{0.0, 0.25, 0.5});
  }
  SECTION("3D Slicer states the times of a sequence in a list") {
    const auto times_of = [&](const std::string& list) {
      auto reader = openNrrd(
          folder.write("a.seq.nrrd",
                       nrrd("2 3 4 3",
                            "kinds: space space space list\nunits: \"mm\" \"mm\" \"mm\" \"s\"\n"
                            "axis 3 index type:=numeric\naxis 3 index values:=" +
                                list + "\n\n"),
                       last));
      checkSteps(*reader);
      CHECK(reader->timeUnit() == 1.0);
      return reader->times();
    };
    CHECK(times_of("0 0.1 0.5") == std::vector<double>{0.0, 0.1, 0.5});
    // Lists that do not have a number for each step are ignored.
    for (const char* list : {"0 0.1", "0 0.1 0.5 1", "a b c", "0 0.1 0.5x"}) {
      CHECK(times_of(list) == std::vector<double>{0.0, 1.0, 2.0});
    }
  }
  SECTION("the time axis is last and each step has its own file") {
    for (int s = 0; s < kSteps; ++s) {
      const auto begin = last.begin() + static_cast<std::ptrdiff_t>(s) * kPoints;
      static_cast<void>(folder.write(fmt::format("{}.raw", s), "", {begin, begin + kPoints}));
    }
    checkSteps(*openNrrd(folder.write(
        "a.nhdr", nrrd("2 3 4 3", "kinds: space space space list\ndata file: %d.raw 0 2 1\n"),
        {})));
  }
  SECTION("the time axis is first") {
    checkSteps(*openNrrd(
        folder.write("a.nrrd", nrrd("3 2 3 4", "kinds: list space space space\n\n"), first)));
  }
  SECTION("the time axis is between the components and the axes of space") {
    checkSteps(
        *openNrrd(folder.write(
            "a.nrrd", nrrd("3 3 2 3 4", "kinds: vector list space space space\n\n"), between)),
        3);
  }
}

TEST_CASE("the time steps of NIfTI files of scalars and of vectors are read in any order",
          "[series]") {
  const Folder folder;
  std::vector<std::int16_t> scalars;
  std::vector<std::int16_t> vectors;
  for (int s = 0; s < kSteps; ++s) {
    for (int p = 0; p < kPoints; ++p) scalars.push_back(valueAt(s, p));
  }
  for (int c = 0; c < 3; ++c) {
    for (int s = 0; s < kSteps; ++s) {
      for (int p = 0; p < kPoints; ++p) vectors.push_back(valueAt(s, p, c));
    }
  }
  std::string header = nifti({2, 3, 4, kSteps}, 2.5F);
  header[123] = 2 + 16;  // mm and ms
  auto reader = openNifti(folder.write("a.nii", header, scalars));
  checkSteps(*reader);
  CHECK(reader->timeUnit() == 1e-3);
  CHECK(reader->times() == std::vector<double>{0.0, 2.5, 5.0});
  checkSteps(*openNifti(folder.write("b.nii", nifti({2, 3, 4, kSteps, 3}, 1.0F), vectors)), 3);
}

TEST_CASE("the time steps of a MetaImage with four dimensions are read in any order", "[series]") {
  const Folder folder;
  std::vector<std::int16_t> scalars;
  std::vector<std::int16_t> vectors;
  for (int s = 0; s < kSteps; ++s) {
    for (int p = 0; p < kPoints; ++p) {
      scalars.push_back(valueAt(s, p));
      for (int c = 0; c < 3; ++c) vectors.push_back(valueAt(s, p, c));
    }
  }
  // Inverts the stored x and y, because the reader turns vectors to RAS.
  for (std::size_t i = 0; i < vectors.size(); ++i) vectors[i] *= i % 3 == 2 ? 1 : -1;
  const std::string head =
      "ObjectType = Image\nNDims = 4\nDimSize = 2 3 4 3\nElementType = MET_SHORT\n"
      "ElementSpacing = 1 2 3 0.25\nOffset = 10 20 30 7\n"
      "TransformMatrix = 0 1 0 0 -1 0 0 0 0 0 1 0 0 0 0 1\n";
  SECTION("the values are in the file") {
    auto reader = openMetaImage(folder.write("a.mha", head + "ElementDataFile = LOCAL\n", scalars));
    checkSteps(*reader);
    CHECK(reader->times() == std::vector<double>{7.0, 7.25, 7.5});
    CHECK_FALSE(reader->timeUnit().has_value());
    const Affine map = reader->read(1).pieces[0].file_from_index;
    CHECK(map.linear.col(0) == Vec3(0.0, -1.0, 0.0));
    CHECK(map.linear.col(1) == Vec3(2.0, 0.0, 0.0));
    CHECK(map.linear.col(2) == Vec3(0.0, 0.0, 3.0));
    CHECK(map.origin == Vec3(-10.0, -20.0, 30.0));
  }
  SECTION("the values are vectors") {
    checkSteps(*openMetaImage(folder.write("a.mha",
                                           head + "ElementNumberOfChannels = 3\n"
                                                  "ElementDataFile = LOCAL\n",
                                           vectors)),
               3, Type::kFloat32);
  }
  SECTION("the values are text") {
    std::string text;
    for (const std::int16_t value : scalars) text += std::to_string(value) + "\n";
    checkSteps(*openMetaImage(
        folder.write("a.mha", head + "BinaryData = False\nElementDataFile = LOCAL\n" + text, {})));
  }
  SECTION("each volume, or each slice, has its own file") {
    for (const int points : {kPoints, 6}) {
      std::string list;
      for (int f = 0; f < kSteps * kPoints / points; ++f) {
        const auto begin = scalars.begin() + static_cast<std::ptrdiff_t>(f) * points;
        static_cast<void>(folder.write(fmt::format("{}.raw", f), "", {begin, begin + points}));
        list += fmt::format("{}.raw\n", f);
      }
      checkSteps(
          *openMetaImage(folder.write("a.mhd", head + "ElementDataFile = LIST\n" + list, {})));
      if (points < kPoints) continue;
      checkSteps(
          *openMetaImage(folder.write("b.mhd", head + "ElementDataFile = %d.raw 0 2 1\n", {})));
    }
  }
}

TEST_CASE("a file with a single volume has no time steps", "[series]") {
  const Folder folder;
  const std::vector<std::int16_t> values(kPoints);
  CHECK(openNrrd(folder.write("a.nrrd", nrrd("2 3 4", "\n"), values))->times().empty());
  CHECK(openNifti(folder.write("a.nii", nifti({2, 3, 4}, 1.0F), values))->times().empty());
  for (const char* sizes : {"NDims = 3\nDimSize = 2 3 4", "NDims = 4\nDimSize = 2 3 4 1"}) {
    const std::string head =
        fmt::format("{}\nElementType = MET_SHORT\nElementDataFile = LOCAL\n", sizes);
    CHECK(openMetaImage(folder.write("a.mha", head, values))->times().empty());
  }
}

}  // namespace palpate::series_test
