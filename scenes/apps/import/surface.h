/// The two steps of OpenVDB from values to a level set. Each is compiled in its own file, which
/// takes 50 s or more.
#pragma once

#include <cstddef>

#include <openvdb/tools/VolumeToMesh.h>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Finds where the grid has the mesher's value, as quads.
void findSurface(const openvdb::FloatGrid& grid, openvdb::tools::VolumeToMesh& mesher);

[[nodiscard]] std::size_t countPolygons(const openvdb::tools::VolumeToMesh& mesher);

/// Returns the unsigned distance from a surface, within three voxels of it.
[[nodiscard]] openvdb::FloatGrid::Ptr distanceTo(const openvdb::tools::VolumeToMesh& mesher,
                                                 const openvdb::math::Transform& transform,
                                                 const Progress& progress);

}  // namespace palpate::importer
