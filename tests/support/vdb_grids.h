/// OpenVDB grids for tests, in addition to the files of vdb_files.h.
#pragma once

#include <functional>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "tests/support/vdb_files.h"

namespace palpate::test {

void writeVdb(const std::filesystem::path& file, const openvdb::GridPtrVec& grids);

/// Returns the level set "ball" of a sphere about the origin, with a half-width of 3 voxels.
openvdb::FloatGrid::Ptr makeBall(double radius, double voxel);

/// Returns a dense block of voxels [0, n)^3 with values from their positions in the file's space.
template <class GridT>
typename GridT::Ptr makeGrid(
    int n, const openvdb::math::Transform::Ptr& transform,
    const std::function<typename GridT::ValueType(const openvdb::Vec3d&)>& value,
    const std::string& name = "density") {
  openvdb::initialize();
  auto grid = GridT::create();
  grid->setTransform(transform);
  grid->setName(name);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      for (int k = 0; k < n; ++k) {
        const openvdb::Coord c(i, j, k);
        grid->tree().setValue(c, value(transform->indexToWorld(c)));
      }
    }
  }
  return grid;
}

}  // namespace palpate::test
