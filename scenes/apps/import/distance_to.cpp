#include <algorithm>
#include <cstddef>
#include <vector>

#include <openvdb/tools/MeshToVolume.h>
#include <openvdb/util/NullInterrupter.h>

#include "palpate/scenes/apps/import/shared_progress.h"
#include "palpate/scenes/apps/import/surface.h"

namespace palpate::importer {
namespace {

using openvdb::Vec3d;

constexpr float kHalfWidth = 3.0F;  ///< [voxels], OpenVDB's default.

/// Presents OpenVDB's surface in another grid's index space, without a copy.
class Surface {
 public:
  Surface(const openvdb::tools::VolumeToMesh& mesher, const openvdb::math::Transform& transform)
      : mesher_(mesher), transform_(transform), first_{0} {
    for (std::size_t pool = 0; pool < mesher.polygonPoolListSize(); ++pool) {
      first_.push_back(first_.back() + mesher.polygonPoolList()[pool].numQuads());
    }
  }

  // The interface of OpenVDB's MeshDataAdapter.
  [[nodiscard]] std::size_t polygonCount() const { return first_.back(); }
  [[nodiscard]] std::size_t pointCount() const { return mesher_.pointListSize(); }
  [[nodiscard]] std::size_t vertexCount(std::size_t /*polygon*/) const { return 4; }
  void getIndexSpacePoint(std::size_t polygon, std::size_t vertex, Vec3d& p_I) const {
    const auto pool = static_cast<std::size_t>(
        std::upper_bound(first_.begin(), first_.end(), polygon) - first_.begin() - 1);
    const openvdb::Vec4I& quad = mesher_.polygonPoolList()[pool].quad(polygon - first_[pool]);
    const openvdb::Vec3s& p = mesher_.pointList()[quad[static_cast<int>(vertex)]];
    p_I = transform_.worldToIndex(Vec3d(p));
  }

 private:
  const openvdb::tools::VolumeToMesh& mesher_;
  const openvdb::math::Transform& transform_;
  std::vector<std::size_t> first_;  ///< Number of polygons before each pool, and the total.
};

/// Forwards OpenVDB's progress, which arrives from any thread.
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

}  // namespace

openvdb::FloatGrid::Ptr distanceTo(const openvdb::tools::VolumeToMesh& mesher,
                                   const openvdb::math::Transform& transform,
                                   const Progress& progress) {
  Watcher watcher(progress);
  return openvdb::tools::meshToVolume<openvdb::FloatGrid>(watcher, Surface(mesher, transform),
                                                          transform, kHalfWidth, kHalfWidth,
                                                          openvdb::tools::UNSIGNED_DISTANCE_FIELD);
}

}  // namespace palpate::importer
