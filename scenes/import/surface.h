/// The two steps between values and a level set, OpenVDB's, each compiled apart: it takes 50 s and
/// more.
#pragma once

#include <cstddef>

#include <openvdb/tools/VolumeToMesh.h>

#include "palpate/samplers/openvdb_grids.h"
#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// Where the grid has the mesher's value, as quads.
void findSurface(const openvdb::FloatGrid& grid, openvdb::tools::VolumeToMesh& mesher);

[[nodiscard]] std::size_t countPolygons(const openvdb::tools::VolumeToMesh& mesher);

/// The distance from a surface without a sign, within three voxels of it.
[[nodiscard]] openvdb::FloatGrid::Ptr distanceTo(const openvdb::tools::VolumeToMesh& mesher,
                                                 const openvdb::math::Transform& transform,
                                                 const Progress& progress);

}  // namespace palpate::importer
