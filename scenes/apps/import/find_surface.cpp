#include "palpate/scenes/apps/import/surface.h"

namespace palpate::importer {

void findSurface(const openvdb::FloatGrid& grid, openvdb::tools::VolumeToMesh& mesher) {
  mesher(grid);
}

std::size_t countPolygons(const openvdb::tools::VolumeToMesh& mesher) {
  std::size_t count = 0;
  for (std::size_t pool = 0; pool < mesher.polygonPoolListSize(); ++pool) {
    count += mesher.polygonPoolList()[pool].numQuads();
  }
  return count;
}

}  // namespace palpate::importer
