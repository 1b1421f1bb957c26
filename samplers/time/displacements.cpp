#include <algorithm>
#include <type_traits>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "palpate/samplers/parallel.h"
#include "palpate/samplers/time/warp_grid.h"

namespace palpate {
namespace {

using openvdb::Coord;

bool sameLattice(const Volume::Grid::Part& a, const Volume::Grid::Part& b) {
  constexpr double kSame = 1e-4;  // for origins, as a share of a voxel's shortest edge
  const double voxel = a.linear.colwise().norm().minCoeff();
  return (a.linear - b.linear).norm() <= kSame * voxel * 1e-2 &&
         (a.origin - b.origin).norm() <= kSame * voxel;
}

openvdb::CoordBBox activeBox(const GridData& data) {
  return std::visit([](const auto& grid) { return grid->evalActiveVoxelBoundingBox(); }, data);
}

std::vector<float> read(const GridData& data, const openvdb::CoordBBox& box, const Mat3& to_rest) {
  const auto side = [&](int a) { return static_cast<std::size_t>(box.dim()[a]); };
  std::vector<float> out(3 * side(0) * side(1) * side(2));
  std::visit(
      [&](const auto& grid) {
        using GridT = std::decay_t<decltype(*grid)>;
        if constexpr (openvdb::VecTraits<typename GridT::ValueType>::IsVec) {
          inParallel(side(0), [&](std::size_t i) {
            const auto accessor = grid->getConstUnsafeAccessor();
            float* to = out.data() + 3 * i * side(1) * side(2);
            for (int j = box.min().y(); j <= box.max().y(); ++j) {
              for (int k = box.min().z(); k <= box.max().z(); ++k, to += 3) {
                const auto v = accessor.getValue(Coord(box.min().x() + static_cast<int>(i), j, k));
                const Vec3 u = to_rest * Vec3(v[0], v[1], v[2]);
                for (int c = 0; c < 3; ++c) to[c] = static_cast<float>(u[c]);
              }
            }
          });
        }
      },
      data);
  return out;
}

}  // namespace

DisplacementFrames displacementsOf(std::span<const std::shared_ptr<const Volume>> frames,
                                   const Placement& placement, const std::string& path) {
  DisplacementFrames out;
  if (frames.empty()) return out;
  const Volume::Grid::Part& first = frames.front()->grid().parts.front();
  openvdb::CoordBBox box;
  for (std::size_t n = 0; n < frames.size(); ++n) {
    const Volume& volume = *frames[n];
    const auto& parts = volume.grid().parts;
    const std::string name = "grid \"" + volume.info().name + "\" of frame " +
                             std::to_string(n + 1) + " of " + std::to_string(frames.size());
    if (!volume.info().vector || parts.size() != 1) {
      throw SceneError(path, name + " is not a vector in one grid, or is staggered",
                       "give one grid of vectors at the voxels' centres");
    }
    if (!sameLattice(first, parts.front())) {
      throw SceneError(path, name + " has another position, orientation or voxel size than frame 1",
                       "resample all displacement fields to one lattice");
    }
    box.expand(activeBox(parts.front().data));
  }
  // With the margin, u beyond the lattice is that of the background, not that of the box's faces.
  const bool sparse = std::any_of(frames.begin(), frames.end(), [&](const auto& volume) {
    return volume->info().active_voxels < box.volume();
  });
  if (sparse) box.expand(1);
  checkWarpMemory({box.dim().x(), box.dim().y(), box.dim().z()}, frames.size(), path);
  const Mat3 to_rest = placement.scale * placement.rotation;
  const Coord low = box.min();
  out.size = {box.dim().x(), box.dim().y(), box.dim().z()};
  out.origin = placement(first.toFile(Vec3(low.x(), low.y(), low.z())));
  out.axes = to_rest * first.linear;
  out.frames.reserve(frames.size());
  for (const auto& volume : frames) {
    out.frames.push_back(read(volume->grid().parts.front().data, box, to_rest));
  }
  return out;
}

}  // namespace palpate
