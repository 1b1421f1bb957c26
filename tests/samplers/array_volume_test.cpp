#include "palpate/samplers/grid/array_volume.h"

#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/vdb_field.h"

namespace palpate::array_volume_test {
using Catch::Contains;

namespace {

/// The test values are 0.25 + i + 100 j + 10000 k, with k fastest in memory.
constexpr std::array<std::int64_t, 3> kSize{9, 10, 17};

template <class Real>
std::vector<Real> ramp() {
  std::vector<Real> values;
  for (std::int64_t i = 0; i < kSize[0]; ++i) {
    for (std::int64_t j = 0; j < kSize[1]; ++j) {
      for (std::int64_t k = 0; k < kSize[2]; ++k) {
        values.push_back(static_cast<Real>(0.25 + static_cast<double>(i + 100 * j + 10000 * k)));
      }
    }
  }
  return values;
}

template <class Real>
VoxelArray viewOf(const std::vector<Real>& values) {
  VoxelArray array;
  array.values = values.data();
  array.type = sizeof(Real) == 4 ? VoxelArray::Type::kFloat : VoxelArray::Type::kDouble;
  array.size = kSize;
  const auto bytes = static_cast<std::ptrdiff_t>(sizeof(Real));
  array.stride = {bytes * kSize[1] * kSize[2], bytes * kSize[2], bytes};
  return array;
}

ScalarSample scalarAt(const std::shared_ptr<const Volume>& volume, const Vec3& p) {
  const FieldPtr field = makeVdbField(volume, Placement{});
  FieldCache cache;
  std::get<0>(field)->reset(cache);
  return std::get<0>(field)->sample(p, cache);
}

std::string refusal(const VoxelArray& array) {
  try {
    (void)makeVolume(array);
  } catch (const VolumeError& e) {
    return e.what();
  }
  return "no error";
}

}  // namespace

TEST_CASE("the values of an array are at the positions that its axes define", "[volume]") {
  const auto values = ramp<double>();
  VoxelArray array = viewOf(values);
  array.name = "ramp";
  array.origin = {1.0, 2.0, 3.0};
  array.axes << 0.5, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, -1.0, 0.0;  // k along y, j along -z
  const auto volume = makeVolume(array);
  CHECK(volume->info().name == "ramp");
  CHECK(volume->info().type == "double");
  for (const Vec3& at : {Vec3(0, 0, 0), Vec3(8, 9, 16), Vec3(3.5, 2.25, 7.125)}) {
    const ScalarSample s = scalarAt(volume, array.origin + array.axes * at);
    CAPTURE(at.transpose());
    CHECK(s.inside);
    CHECK(s.value == Approx(0.25 + at.x() + 100 * at.y() + 10000 * at.z()));
  }
  const Vec3 gradient = scalarAt(volume, array.origin + array.axes * Vec3(4, 5, 8)).gradient;
  CHECK((gradient - Vec3(1 / 0.5, 10000 / 2.0, 100 / -1.0)).norm() < 1e-6);
}

TEST_CASE("an array is read in any memory order, backwards and with gaps", "[volume]") {
  const auto values = ramp<float>();
  const auto straight = makeVolume(viewOf(values));
  // In memory, i varies fastest and k is reversed. The values have gaps between them, and most
  // addresses are not aligned.
  constexpr std::ptrdiff_t kGap = 7;
  std::vector<std::byte> bytes(values.size() * kGap + 1);
  VoxelArray array = viewOf(values);
  array.stride = {kGap, kGap * kSize[0], -kGap * kSize[0] * kSize[1]};
  std::byte* first = bytes.data() + 1 + kGap * kSize[0] * kSize[1] * (kSize[2] - 1);
  array.values = first;
  std::size_t at = 0;
  for (std::int64_t i = 0; i < kSize[0]; ++i) {
    for (std::int64_t j = 0; j < kSize[1]; ++j) {
      for (std::int64_t k = 0; k < kSize[2]; ++k) {
        std::memcpy(first + i * array.stride[0] + j * array.stride[1] + k * array.stride[2],
                    &values[at++], sizeof(float));
      }
    }
  }
  const auto turned = makeVolume(array);
  CHECK(turned->info().active_voxels == straight->info().active_voxels);
  for (const Vec3& p : {Vec3(0, 0, 0), Vec3(8, 9, 16), Vec3(1.5, 2.5, 3.5), Vec3(7, 8, 1)}) {
    CHECK(scalarAt(turned, p).value == scalarAt(straight, p).value);
  }
}

TEST_CASE("array voxels that equal the background are inactive", "[volume]") {
  // A cube with an edge of six voxels has the value 5. All other voxels, up to the outer faces,
  // have the background value -1000.
  constexpr std::int64_t kEdge = 20;
  std::vector<float> values(kEdge * kEdge * kEdge, -1000.0F);
  for (std::int64_t i = 6; i < 12; ++i) {
    for (std::int64_t j = 6; j < 12; ++j) {
      for (std::int64_t k = 6; k < 12; ++k) {
        values[static_cast<std::size_t>((i * kEdge + j) * kEdge + k)] = 5.0F;
      }
    }
  }
  VoxelArray array = viewOf(values);
  array.size = {kEdge, kEdge, kEdge};
  array.stride = {4 * kEdge * kEdge, 4 * kEdge, 4};
  const auto volume = makeVolume(array);
  CHECK(volume->info().active_voxels == 6 * 6 * 6);
  CHECK(volume->info().background == -1000.0);
  CHECK(scalarAt(volume, Vec3(8, 8, 8)).value == 5.0);
  CHECK_FALSE(scalarAt(volume, Vec3(2, 2, 2)).inside);
  array.background = 5.0;
  CHECK(makeVolume(array)->info().active_voxels == kEdge * kEdge * kEdge - 6 * 6 * 6);
}

TEST_CASE("an array of vectors gives one vector grid", "[volume]") {
  std::vector<double> values;
  for (int i = 0; i < 4 * 4 * 4; ++i) values.insert(values.end(), {1.0 * i, 2.0 * i, -3.0 * i});
  VoxelArray array;
  array.values = values.data();
  array.type = VoxelArray::Type::kDouble;
  array.vector = true;
  array.size = {4, 4, 4};
  array.stride = {8 * 48, 8 * 12, 8 * 3};
  array.component_stride = 8;
  const auto volume = makeVolume(array);
  CHECK(volume->info().vector);
  CHECK(volume->info().active_voxels == 63);  // the first value is zero, the background value
  const FieldPtr field = makeVdbField(volume, Placement{});
  FieldCache cache;
  std::get<1>(field)->reset(cache);
  CHECK(std::get<1>(field)->sample(Vec3(2, 1, 3), cache).value == Vec3(39, 78, -117));
}

TEST_CASE("an unusable array is refused with its name", "[volume]") {
  auto values = ramp<float>();
  VoxelArray array = viewOf(values);
  array.name = "mri";
  REQUIRE(refusal(array) == "no error");
  VoxelArray null = array;
  null.values = nullptr;
  CHECK_THAT(refusal(null), Contains("mri: it has no values"));
  VoxelArray empty = array;
  empty.size[1] = 0;
  CHECK_THAT(refusal(empty), Contains("mri: it has 0 values along axis 2 of 3"));
  VoxelArray flat = array;
  flat.axes.col(2) = flat.axes.col(1);
  CHECK_THAT(refusal(flat), Contains("mri: its voxels have no volume"));
  VoxelArray nowhere = array;
  nowhere.origin.x() = std::numeric_limits<double>::quiet_NaN();
  CHECK_THAT(refusal(nowhere),
             Contains("mri: its voxels have no volume, or its spacing or origin"));
  VoxelArray beside = array;
  beside.background = std::numeric_limits<double>::quiet_NaN();
  CHECK_THAT(refusal(beside), Contains("mri: its background is not a finite number"));
  VoxelArray tiny = array;
  tiny.axes *= 1e-9;
  CHECK_THAT(refusal(tiny), Contains("mri: "));
  values[77] = std::numeric_limits<float>::quiet_NaN();
  CHECK_THAT(refusal(array), Contains("mri"));
  LoadOptions fill;
  fill.non_finite = NonFinite::kFill;
  CHECK(makeVolume(array, fill)->info().filled == 1);
  std::fill(values.begin(), values.end(), 3.0F);
  CHECK_THAT(refusal(array), Contains("all its values equal the background"));
}

}  // namespace palpate::array_volume_test
