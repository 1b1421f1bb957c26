#include <algorithm>

#include <openvdb/tools/Interpolation.h>

#include "palpate/scenes/apps/import/differences.h"
#include "palpate/scenes/apps/import/resample.h"

namespace palpate::importer {
namespace {

using openvdb::Vec3d;

template <class GridT>
Differences compareAt(const Piece& image, const Array& array, const GridT& grid) {
  Differences differences;
  const auto accessor = grid.getConstAccessor();
  const auto* hidden = image.hidden.as<std::uint8_t>();
  const int components = array.values.components();
  const auto row = static_cast<std::size_t>(image.size[0]);
  const auto rows = static_cast<std::size_t>(image.size[1]);
  // In a large image, compares only voxels at regular intervals.
  const std::size_t count = array.values.tuples();
  const std::size_t stride = count / 200000 + 1;
  for (std::size_t point = 0; point < count; point += stride) {
    if (hidden != nullptr && hidden[point] != 0) continue;
    Vec3d v(0.0);
    for (int c = 0; c < components; ++c) v[c] = array.values.at(point, c);
    if (!v.isFinite()) continue;
    const std::size_t i = point % row;
    const std::size_t j = point / row % rows;
    const std::size_t k = point / row / rows;
    const Vec3 p =
        image.file_from_index.linear *
            Vec3(static_cast<double>(i), static_cast<double>(j), static_cast<double>(k)) +
        image.file_from_index.origin;
    const auto there =
        openvdb::tools::BoxSampler::sample(accessor, grid.worldToIndex(Vec3d(p.x(), p.y(), p.z())));
    if constexpr (std::is_same_v<GridT, openvdb::FloatGrid>) {
      differences.within.add(std::abs(v.x() - static_cast<double>(there)));
    } else {
      differences.within.add((v - Vec3d(there)).length());
    }
  }
  return differences;
}

}  // namespace

ResamplingError errorOf(const Piece& image, const Array& array, const Gridded& made) {
  if (const auto scalar = openvdb::gridConstPtrCast<openvdb::FloatGrid>(made.grid)) {
    const double low = std::min(made.lowest, made.background);
    return compareAt(image, array, *scalar)
        .relativeTo(std::max(made.highest, made.background) - low);
  }
  return compareAt(image, array, *openvdb::gridConstPtrCast<openvdb::Vec3SGrid>(made.grid))
      .relativeTo(made.highest);
}

}  // namespace palpate::importer
