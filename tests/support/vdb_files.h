/// Small .vdb files for tests, made with OpenVDB's own tools.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <functional>
#include <string>
#include <unistd.h>

#include <openvdb/openvdb.h>

#include "engine/types.h"

namespace palpate::test {

/// A folder that is gone when the test is over.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "palpate-XXXXXX").string();
    path_ = mkdtemp(pattern.data());
  }
  ~TemporaryFolder() {
    std::error_code error;
    std::filesystem::remove_all(path_, error);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  [[nodiscard]] std::filesystem::path operator/(const std::string& name) const {
    return path_ / name;
  }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// Writes grids to a file, unless a grid of openvdb::io is given otherwise uncompressed.
inline void writeVdb(const std::filesystem::path& file, const openvdb::GridPtrVec& grids) {
  openvdb::io::File out(file.string());
  out.write(grids);
  out.close();
}

/// A dense block of voxels [0, n)^3 given by a function of their file-space position.
template <class GridT>
typename GridT::Ptr makeGrid(
    int n, const openvdb::math::Transform::Ptr& transform,
    const std::function<typename GridT::ValueType(const openvdb::Vec3d&)>& value,
    const std::string& name = "density") {
  openvdb::initialize();
  auto grid = GridT::create();
  grid->setTransform(transform);
  grid->setName(name);
  auto accessor = grid->getAccessor();
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      for (int k = 0; k < n; ++k) {
        const openvdb::Coord c(i, j, k);
        accessor.setValue(c, value(transform->indexToWorld(c)));
      }
    }
  }
  return grid;
}

}  // namespace palpate::test
