#include "palpate/samplers/grid/vdb_field.h"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/free_map.h"
#include "palpate/samplers/grid/grid_field.h"
#include "palpate/samplers/grid/volume_grid.h"

namespace palpate {
namespace detail {
namespace {

/// Makes the map of the regions where a grid is inactive and has the value of the background.
FreeMap freeMapOf(const GridData& data) {
  std::vector<FreeMap::Voxels> busy;
  std::visit(
      [&](const auto& grid) {
        const auto& tree = grid->tree();
        const auto& background = tree.background();
        const auto add = [&](const openvdb::CoordBBox& box) {
          busy.push_back({{box.min().x(), box.min().y(), box.min().z()},
                          {box.max().x(), box.max().y(), box.max().z()}});
        };
        busy.reserve(tree.leafCount());
        for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) {
          const auto* values = leaf->buffer().data();
          const auto other = [&](const auto& value) { return value != background; };
          if (!leaf->isEmpty() || std::any_of(values, values + leaf->size(), other)) {
            add(leaf->getNodeBoundingBox());
          }
        }
        auto tile = tree.cbeginValueAll();
        tile.setMaxDepth(tile.getLeafDepth() - 1);
        for (; tile; ++tile) {
          if (tile.isValueOn() || *tile != background) add(tile.getBoundingBox());
        }
      },
      data);
  return FreeMap(busy);
}

}  // namespace

FieldFrame frameOf(const Volume& volume, const Placement& placement, const Sampling& sampling) {
  // The margin is the distance by which a cell with an active corner can extend beyond the centres
  // of the voxels that were active before smoothing.
  Vec3 voxels = Vec3::Zero();
  for (const Volume::Grid::Part& part : volume.grid().parts) voxels = voxels.cwiseMax(part.grown);
  const Vec3 margin = volume.grid().parts.front().linear.cwiseAbs() * (voxels + Vec3::Ones());
  const Box& file = volume.info().bounds;
  FieldFrame frame;
  frame.voxel = volume.info().voxel.minCoeff() * placement.scale;
  frame.metres_per_unit = placement.scale;
  frame.bounds = boxAbout({file.lower - margin, file.upper + margin}, placement);
  frame.background = volume.info().background;
  frame.distance = volume.info().grid_class == GridClass::kLevelSet;
  if (sampling.interpolation == Interpolation::kTrilinear) {
    frame.reach = sampling.slope_reach * placement.scale * placement.rotation *
                  volume.grid().parts.front().linear;
  }
  return frame;
}

std::shared_ptr<const FreeMap> freeMapOf(const Volume& volume, std::size_t part,
                                         Interpolation interpolation, const GridData& data) {
  const Volume::Grid& grid = volume.grid();
  const bool quadratic = interpolation == Interpolation::kQuadratic;
  const bool cubic = interpolation == Interpolation::kCubic;
  Volume::Grid::FreeMaps& made = grid.free_maps[quadratic ? 1 : cubic ? 2 : 0];
  const std::lock_guard lock(made.mutex);
  made.parts.resize(grid.parts.size());
  std::shared_ptr<const FreeMap>& map = made.parts[part];
  if (map == nullptr) map = std::make_shared<const FreeMap>(freeMapOf(data));
  return map;
}

}  // namespace detail

Placement fitInto(const GridInfo& volume, double size) {
  const std::string what = "grid \"" + volume.name + "\"";
  const Box& bounds_F = volume.bounds;
  const double longest = bounds_F.size().maxCoeff();
  if (bounds_F.empty() || longest == 0.0) {
    throw VolumeError(
        what,
        std::string(bounds_F.empty() ? "it has no voxel with data" : "it is a single voxel") +
            ", so it has no extent to fit",
        "use \"scale\" instead of \"fit\"");
  }
  if (!std::isfinite(longest) || !bounds_F.centre().allFinite()) {
    throw VolumeError(what, "its bounds are not finite",
                      "write it with a smaller voxel size or origin");
  }
  Placement placement;
  placement.scale = size / longest;
  placement.translate = -placement.scale * bounds_F.centre();
  return placement;
}

FieldPtr makeVdbField(const std::shared_ptr<const Volume>& volume, const Placement& placement,
                      const Sampling& sampling) {
  const std::vector<Volume::Grid::Part>& parts = volume->grid().parts;
  const std::string what = "grid \"" + volume->info().name + "\"";
  if (!(sampling.slope_reach > 0.0 && sampling.slope_reach <= 1.0)) {
    throw VolumeError(what, "slope_reach is " + std::to_string(sampling.slope_reach) + " voxels",
                      "give a number above 0 and at most 1, such as 0.5");
  }
  if (sampling.axial) {
    if (!volume->info().vector) {
      throw VolumeError(what, "it is a scalar, and only vectors can be axial", "remove \"axial\"");
    }
    if (parts.size() > 1) {
      throw VolumeError(what,
                        "its components are separate grids or staggered, so it cannot be axial",
                        "write it as one grid of vectors at the voxels' centres, or remove "
                        "\"axial\" if the signs of its vectors matter");
    }
    if (sampling.interpolation != Interpolation::kTrilinear) {
      throw VolumeError(what,
                        std::string("axial vectors do not support ") +
                            wordFor(sampling.interpolation) + " interpolation",
                        "use trilinear");
    }
  }
  return std::visit(
      [&](const auto& grid) -> FieldPtr {
        using GridT = std::remove_const_t<typename std::decay_t<decltype(grid)>::element_type>;
        return detail::makeField<GridT>(volume, placement, sampling);
      },
      parts.front().data);
}

const char* wordFor(Interpolation interpolation) noexcept {
  switch (interpolation) {
    case Interpolation::kTrilinear:
      return "trilinear";
    case Interpolation::kNearest:
      return "nearest";
    case Interpolation::kQuadratic:
      return "quadratic";
    case Interpolation::kCubic:
      return "cubic";
  }
  return "";
}

std::optional<Interpolation> interpolationNamed(const std::string& word) noexcept {
  for (const Interpolation i : {Interpolation::kTrilinear, Interpolation::kNearest,
                                Interpolation::kQuadratic, Interpolation::kCubic}) {
    if (word == wordFor(i)) return i;
  }
  return std::nullopt;
}

}  // namespace palpate
