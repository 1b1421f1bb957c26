#include "palpate/scenes/apps/import/level_set.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <fmt/format.h>
#include <openvdb/tools/Interpolation.h>
#include <openvdb/tools/MeshToVolume.h>
#include <openvdb/tools/SignedFloodFill.h>
#include <openvdb/tools/VolumeToMesh.h>
#include <openvdb/util/NullInterrupter.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/grids.h"
#include "palpate/scenes/apps/import/quantile.h"
#include "palpate/scenes/apps/import/shared_progress.h"

namespace palpate::importer {
namespace {

using openvdb::Coord;
using openvdb::Vec3d;
using openvdb::tools::BoxSampler;

constexpr float kHalfWidth = 3.0F;  ///< [voxels]

/// Passes on the progress that OpenVDB reports from several threads.
class Watcher final : public openvdb::util::NullInterrupter {
 public:
  explicit Watcher(const Progress& progress) : shared_(progress, 100) {}

  bool wasInterrupted(int percent = -1) override {
    if (percent >= 0) shared_.tell(percent / 100.0);
    return false;
  }

 private:
  SharedProgress shared_;
};

/// Returns the fraction of the original surface's points whose distance from the level set's
/// surface is at least a voxel.
double lostPart(const std::vector<openvdb::Vec3s>& points, const openvdb::FloatGrid& surface) {
  const auto level = surface.getConstAccessor();
  const double edge = surface.voxelSize().x();
  const auto lost = std::count_if(points.begin(), points.end(), [&](const openvdb::Vec3s& p) {
    return std::abs(BoxSampler::sample(level, surface.worldToIndex(Vec3d(p)))) >= edge;
  });
  return static_cast<double>(lost) / static_cast<double>(std::max<std::size_t>(points.size(), 1));
}

/// Returns the first-order distances from the original isosurface, at the points where voxel edges
/// cross the level set.
std::vector<double> distances(const openvdb::FloatGrid& surface, const openvdb::FloatGrid& original,
                              double iso) {
  const auto level = surface.getConstAccessor();
  const auto values = original.getConstAccessor();
  const Vec3d edges = original.voxelSize();
  const double step = 0.5 * std::min({edges.x(), edges.y(), edges.z()});
  const auto at = [&](const Vec3d& p) {
    return static_cast<double>(BoxSampler::sample(values, original.worldToIndex(p)));
  };
  std::vector<double> out;
  for (auto value = surface.cbeginValueOn(); value; ++value) {
    const Coord here = value.getCoord();
    for (int axis = 0; axis < 3; ++axis) {
      Coord there = here;
      ++there[axis];
      float other = 0.0F;
      if (!level.probeValue(there, other) || (*value < 0.0F) == (other < 0.0F)) continue;
      const double share = static_cast<double>(*value) / (static_cast<double>(*value) - other);
      const Vec3d p =
          surface.indexToWorld(here.asVec3d() + share * (there.asVec3d() - here.asVec3d()));
      Vec3d slope;
      for (int a = 0; a < 3; ++a) {
        Vec3d along(0.0);
        along[a] = step;
        slope[a] = (at(p + along) - at(p - along)) / (2.0 * step);
      }
      if (slope.length() > 0.0) out.push_back(std::abs(at(p) - iso) / slope.length());
    }
  }
  return out;
}

}  // namespace

LevelSet levelSetOf(const openvdb::FloatGrid& grid, double iso, double voxel,
                    const std::string& file, const Progress& progress, bool may_be_empty) {
  const Vec3d edges = grid.voxelSize();
  const double edge = voxel > 0.0 ? voxel : std::min({edges.x(), edges.y(), edges.z()});
  const auto transform = cubes(edge, Vec3d(0.0), file);
  LevelSet out;
  out.solid_above = static_cast<double>(grid.background()) < iso;
  std::vector<openvdb::Vec3s> points;
  std::vector<openvdb::Vec4I> quads;
  if (!grid.empty()) openvdb::tools::volumeToMesh(grid, points, quads, iso);
  if (quads.empty() && may_be_empty) {
    out.grid = openvdb::FloatGrid::create(kHalfWidth * static_cast<float>(edge));
    out.grid->setTransform(transform);
    out.grid->setName(grid.getName());
    out.grid->setGridClass(openvdb::GRID_LEVEL_SET);
    return out;
  }
  if (quads.empty()) {
    throw VolumeError(
        file, fmt::format("no surface in \"{}\" has the value of --iso", grid.getName()),
        "give an --iso within the range of the file's values, which an import without --iso "
        "prints");
  }
  const double refinement = std::max({edges.x(), edges.y(), edges.z()}) / edge;
  if (static_cast<double>(quads.size()) * refinement * refinement * 6.0 > 1e9) {
    throw VolumeError(
        file,
        fmt::format(
            "the surface would need too many voxels with an edge of {:g}, in the file's unit (more "
            "than 1e9)",
            edge),
        "give a larger --voxel");
  }
  // OpenVDB's own signs would fill cavities, because all that a surface encloses counts as inside.
  Watcher watcher(progress);
  out.grid = openvdb::tools::meshToUnsignedDistanceField<openvdb::FloatGrid>(
      watcher.interrupter(), *transform, points, {}, quads, kHalfWidth);
  quads = {};
  // The values determine the side; a value equal to `iso` counts as above.
  const auto accessor = grid.getConstAccessor();
  std::uint64_t inside = 0;
  for (auto value = out.grid->beginValueOn(); value; ++value) {
    const Vec3d p = out.grid->indexToWorld(value.getCoord());
    const bool above = BoxSampler::sample(accessor, grid.worldToIndex(p)) >= iso;
    const float distance = std::abs(*value);
    if (above == out.solid_above) ++inside;
    value.setValue(above == out.solid_above ? -distance : distance);
  }
  openvdb::tools::signedFloodFill(out.grid->tree());
  if (inside == 0) {
    throw VolumeError(file, "the solid at the value of --iso is thinner than the voxels",
                      "give a smaller --voxel or another --iso");
  }
  out.lost = lostPart(points, *out.grid);
  points = {};

  std::vector<double> errors = distances(*out.grid, grid, iso);
  out.crossings = errors.size();
  if (!errors.empty()) {
    double squares = 0.0;
    for (const double e : errors) squares += e * e;
    out.rms_error = std::sqrt(squares / static_cast<double>(errors.size())) / edge;
    out.p99_error = quantile(errors, 0.99) / edge;
  }
  out.grid->setName(grid.getName());
  out.grid->setGridClass(openvdb::GRID_LEVEL_SET);
  return out;
}

}  // namespace palpate::importer
