/// Tests masks of labels, and labels in the metadata of a grid.
#include "palpate/samplers/grid/label_mask.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/labels.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "tests/support/random.h"
#include "tests/support/vdb_grids.h"

namespace palpate::label_mask_test {
using namespace palpate::test;
using Catch::Contains;
using openvdb::Coord;
using openvdb::math::Transform;

namespace {

using Labels = std::function<float(const openvdb::Vec3d&)>;

openvdb::FloatGrid::Ptr labelGrid(int n, const Labels& label) {
  return makeGrid<openvdb::FloatGrid>(n, Transform::createLinearTransform(1.0), label, "organs");
}

std::shared_ptr<const ScalarField> fieldOf(const std::shared_ptr<const Volume>& mask) {
  return std::get<std::shared_ptr<const ScalarField>>(makeVdbField(mask, Placement{}));
}

/// Returns the distance from `centre` along `direction` at which the mask falls below 0.5.
double surfaceAlong(const ScalarField& field, const Vec3& centre, const Vec3& direction,
                    double inside, double outside) {
  FieldCache cache;
  field.reset(cache);
  for (int i = 0; i < 50; ++i) {
    const double middle = 0.5 * (inside + outside);
    (field.sample(centre + middle * direction, cache).value > 0.5 ? inside : outside) = middle;
  }
  return 0.5 * (inside + outside);
}

std::string refusalOf(const std::shared_ptr<const Volume>& volume,
                      const std::vector<LabelKey>& labels) {
  try {
    (void)makeLabelMask(volume, labels);
  } catch (const VolumeError& e) {
    return e.what();
  }
  return "made";
}

/// Errors of a smoothed surface against the exact one [voxels, degrees].
struct SurfaceError {
  double mean = 0.0;
  double rough = 0.0;    ///< Root mean square about the mean.
  double largest = 0.0;  ///< Largest distance from the exact surface.
  double turned = 0.0;   ///< Root mean square of the angles between the normals.
  double most_turned = 0.0;
};

SurfaceError errorOf(const ScalarField& field, const std::vector<Vec3>& points,
                     const std::vector<Vec3>& normals) {
  FieldCache cache;
  field.reset(cache);
  double sum = 0.0;
  double squares = 0.0;
  double turned = 0.0;
  SurfaceError out;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double d = surfaceAlong(field, points[i], normals[i], -3.0, 3.0);
    const Vec3 slope = field.sample(points[i] + d * normals[i], cache).gradient;
    const double cosine = -slope.normalized().dot(normals[i]);
    const double angle = std::acos(std::clamp(cosine, -1.0, 1.0)) * 180.0 / M_PI;
    sum += d;
    squares += d * d;
    turned += angle * angle;
    out.largest = std::max(out.largest, std::abs(d));
    out.most_turned = std::max(out.most_turned, angle);
  }
  const auto count = static_cast<double>(points.size());
  out.mean = sum / count;
  out.rough = std::sqrt(squares / count - out.mean * out.mean);
  out.turned = std::sqrt(turned / count);
  return out;
}

}  // namespace

TEST_CASE(
    "a flat boundary of a label along the lattice stays on the voxels' faces for sigma up to 3",
    "[labels]") {
  const auto volume = makeVolume(*labelGrid(
      40, [](const openvdb::Vec3d& p) { return p.x() > 9.5 && p.x() < 29.5 ? 7.0F : 2.0F; }));
  for (const double sigma : {0.0, 0.5, 1.0, 3.0}) {
    const auto field = fieldOf(makeLabelMask(volume, {7.0}, sigma));
    CAPTURE(sigma);
    const Vec3 centre(20.0, 20.3, 19.6);
    CHECK(surfaceAlong(*field, centre, Vec3::UnitX(), 0.0, 15.0) == Approx(9.5).margin(1e-6));
    CHECK(surfaceAlong(*field, centre, -Vec3::UnitX(), 0.0, 15.0) == Approx(10.5).margin(1e-6));
  }
}

TEST_CASE("a labelled ball shrinks by sigma^2 / R, and smoothing removes its steps", "[labels]") {
  Random random(5);
  for (const double radius : {5.0, 10.0, 20.0}) {
    const int n = static_cast<int>(2.0 * radius) + 20;
    const Vec3 centre = Vec3::Constant(0.5 * n) + random.inCube(0.5);
    const auto volume = makeVolume(*labelGrid(n, [&](const openvdb::Vec3d& p) {
      return (Vec3(p.x(), p.y(), p.z()) - centre).norm() < radius ? 7.0F : 0.0F;
    }));
    std::vector<Vec3> points;
    std::vector<Vec3> normals;
    for (int i = 0; i < 3000; ++i) {
      normals.push_back(random.direction());
      points.push_back(centre + radius * normals.back());
    }
    for (const double sigma : {0.0, 0.5, 1.0, 2.0}) {
      const SurfaceError error =
          errorOf(*fieldOf(makeLabelMask(volume, {7.0}, sigma)), points, normals);
      CAPTURE(radius, sigma, error.mean, error.rough, error.largest, error.turned,
              error.most_turned);
      const double shrinks = sigma * sigma / radius;
      CHECK(error.mean == Approx(-shrinks).margin(0.05 + 0.2 * shrinks));
      CHECK(error.largest < 0.51 + 1.4 * shrinks);
      if (sigma == 0.0) CHECK(error.turned > 15.0);
      if (sigma == 1.0) {
        CHECK(error.rough < 0.08);
        CHECK(error.turned < 5.0);
        CHECK(error.most_turned < 25.0);
      }
    }
  }
}

TEST_CASE("a mask joins labels, reads tiles and doubles, and may include the background",
          "[labels]") {
  auto grid = openvdb::DoubleGrid::create(0.0);
  grid->setName("organs");
  grid->tree().addTile(1, Coord(0, 0, 0), 7.0, true);
  grid->tree().addTile(1, Coord(8, 0, 0), 3.0, false);
  grid->tree().setValueOn(Coord(16, 0, 0), 5.0);
  const auto volume = makeVolume(*grid);
  const auto valueAt = [&](const std::vector<LabelKey>& labels, double x) {
    const auto field = fieldOf(makeLabelMask(volume, labels, 0.0));
    FieldCache cache;
    field->reset(cache);
    return field->sample({x, 0.0, 0.0}, cache).value;
  };
  for (const double x : {0.0, 7.0, 8.0, 15.0, 16.0, 17.0}) {
    CAPTURE(x);
    CHECK(valueAt({7.0}, x) == (x < 8.0 ? 1.0 : 0.0));
    CHECK(valueAt({7.0, 3.0}, x) == (x < 16.0 ? 1.0 : 0.0));
    CHECK(valueAt({0.0}, x) == (x > 16.0 ? 1.0 : 0.0));
    CHECK(valueAt({5.0, 0.0}, x) == (x > 15.0 ? 1.0 : 0.0));
  }
}

TEST_CASE(
    "a label without voxels is refused with the grid's labels, and an ambiguous name with its "
    "values",
    "[labels]") {
  const auto grid = labelGrid(
      12, [](const openvdb::Vec3d& p) { return p.x() < 4.0 ? 1.0F : (p.x() < 8.0 ? 2.0F : 7.0F); });
  CHECK_THAT(refusalOf(makeVolume(*grid), {9.0}),
             Contains("no voxel with the label 9") && Contains("choose from 1, 2, 7"));
  CHECK_THAT(refusalOf(makeVolume(*grid), {"liver"}), Contains("choose from 1, 2, 7"));
  CHECK_THAT(refusalOf(makeVolume(*grid), {0.0, 1.0, 2.0, 7.0}), Contains("no surface"));
  CHECK_THAT(refusalOf(makeVolume(*grid), {9.0}), Contains("7, the background 0"));
  insertLabels(*grid, {{1.0, "liver", Vec3(0.8, 0.5, 0.25)}, {4.0, "spleen", std::nullopt}});
  const auto named = makeVolume(*grid);
  CHECK_THAT(refusalOf(named, {1.0, "kidney"}), Contains("no voxel with the label kidney") &&
                                                    Contains("choose from 1 liver, 4 spleen"));
  CHECK_THAT(refusalOf(named, {"spleen"}), Contains("no voxel with the label spleen"));
  CHECK(refusalOf(named, {"liver"}) == "made");
  CHECK(makeLabelMask(named, {"liver", 2.0})->info().colour == Vec3(0.8, 0.5, 0.25));
  CHECK_FALSE(makeLabelMask(named, {2.0})->info().colour);
  insertLabels(*grid, {{1.0, "lung", std::nullopt}, {2.0, "lung", std::nullopt}});
  const auto twice = makeVolume(*grid);
  CHECK_THAT(refusalOf(twice, {"lung"}),
             Contains("labels 1 and 2 both have the name \"lung\": give the value"));
  CHECK(refusalOf(twice, {2.0}) == "made");
  // Values that are not whole numbers are not labels.
  const auto image =
      labelGrid(12, [](const openvdb::Vec3d& p) { return static_cast<float>(0.3 * p.x()); });
  CHECK_THAT(refusalOf(makeVolume(*image), {9.0}), Contains("not a few whole numbers"));
  CHECK_THAT(refusalOf(makeVolume(*makeBall(2.0, 0.1)), {1.0}), Contains("it is a level set"));
}

TEST_CASE(
    "labels in the metadata are read back from a file, without those that have no valid value",
    "[labels]") {
  const auto grid = labelGrid(4, [](const openvdb::Vec3d& p) { return static_cast<float>(p.x()); });
  insertLabels(*grid, {{3.0, "left lung", Vec3(0.1, 0.25, 1.0)}, {-2.0, "", std::nullopt}});
  const auto meta = [&](const char* key, const char* text) {
    grid->insertMeta(key, openvdb::StringMetadata(text));
  };
  meta("Segment2_LabelValue", "9");
  meta("Segment2_Name", "two\nlines");
  meta("Segment2_Color", "2 -1 half");
  meta("Segment3_LabelValue", "1.5");
  meta("Segment4_LabelValue", "1e30");
  meta("Segment05_LabelValue", "6");
  meta("Segment_LabelValue", "6");
  meta("Segment6_LabelValue", "");
  grid->insertMeta("Segment7_LabelValue", openvdb::Int32Metadata(6));
  const TemporaryFolder folder;
  writeVdb(folder / "a.vdb", {grid});
  const std::vector<Label> labels = loadVolume(folder / "a.vdb", "")->info().labels;
  REQUIRE(labels.size() == 3);
  CHECK(labels[0].value == 3.0);
  CHECK(labels[0].name == "left lung");
  CHECK(labels[0].colour == Vec3(0.1, 0.25, 1.0));
  CHECK(labels[1].value == -2.0);
  CHECK(labels[1].name.empty());
  CHECK_FALSE(labels[1].colour);
  CHECK(labels[2].name == "two lines");
  CHECK_FALSE(labels[2].colour);
}

}  // namespace palpate::label_mask_test
