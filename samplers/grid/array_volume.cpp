#include "palpate/samplers/grid/array_volume.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <type_traits>
#include <utility>
#include <vector>

#include <Eigen/LU>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "palpate/samplers/parallel.h"

namespace palpate {
namespace {

constexpr std::int64_t kMostAlong = std::numeric_limits<std::int32_t>::max();

template <class GridT>
struct ArrayValues {
  using Value = typename GridT::ValueType;
  static constexpr bool kVector = !std::is_arithmetic_v<Value>;

  const VoxelArray& array;

  [[nodiscard]] Value at(std::int64_t i, std::int64_t j, std::int64_t k) const {
    const auto* place = static_cast<const std::byte*>(array.values) + i * array.stride[0] +
                        j * array.stride[1] + k * array.stride[2];
    // Copies bytes, because the address may be unaligned.
    Value value;
    if constexpr (kVector) {
      for (int c = 0; c < 3; ++c) {
        std::memcpy(&value[c], place + c * array.component_stride, sizeof(value[c]));
      }
    } else {
      std::memcpy(&value, place, sizeof(value));
    }
    return value;
  }
};

/// Returns the default background: the median of the finite values on the six faces; 0 if no value
/// there is finite.
template <class GridT>
double medianOfFaces(const ArrayValues<GridT>& values) {
  const std::array<std::int64_t, 3>& size = values.array.size;
  std::vector<double> seen;
  const auto add = [&](std::int64_t i, std::int64_t j, std::int64_t k) {
    const double value = values.at(i, j, k);
    if (std::isfinite(value)) seen.push_back(value);
  };
  for (std::int64_t i = 0; i < size[0]; ++i) {
    for (std::int64_t j = 0; j < size[1]; ++j) {
      const bool edge = i == 0 || j == 0 || i == size[0] - 1 || j == size[1] - 1;
      const std::int64_t step = edge ? 1 : std::max<std::int64_t>(size[2] - 1, 1);
      for (std::int64_t k = 0; k < size[2]; k += step) add(i, j, k);
    }
  }
  if (seen.empty()) return 0.0;
  const auto middle = seen.begin() + static_cast<std::ptrdiff_t>(seen.size() / 2);
  std::nth_element(seen.begin(), middle, seen.end());
  return *middle;
}

template <class GridT>
std::unique_ptr<typename GridT::TreeType::LeafNodeType> leafOf(
    const ArrayValues<GridT>& values, const openvdb::Coord& origin,
    const typename GridT::ValueType& background) {
  using Leaf = typename GridT::TreeType::LeafNodeType;
  auto leaf = std::make_unique<Leaf>(origin, background);
  std::array<std::int32_t, 3> end{};
  for (int a = 0; a < 3; ++a) {
    const auto axis = static_cast<std::size_t>(a);
    end[axis] = static_cast<std::int32_t>(
        std::min<std::int64_t>(std::int64_t{origin[a]} + Leaf::DIM, values.array.size[axis]));
  }
  openvdb::Coord c;
  for (c.x() = origin.x(); c.x() < end[0]; ++c.x()) {
    for (c.y() = origin.y(); c.y() < end[1]; ++c.y()) {
      for (c.z() = origin.z(); c.z() < end[2]; ++c.z()) {
        const auto value = values.at(c.x(), c.y(), c.z());
        // A NaN does not equal the background. It becomes active, and later checks detect it.
        if (!(value == background)) leaf->setValueOn(Leaf::coordToOffset(c), value);
      }
    }
  }
  if (leaf->isEmpty()) leaf.reset();
  return leaf;
}

/// Returns the map of an array in OpenVDB's convention, in which matrices multiply row vectors.
openvdb::math::Transform::Ptr transformOf(const VoxelArray& array) {
  openvdb::Mat4R map;
  map.setIdentity();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) map(column, row) = array.axes(row, column);
    map(3, row) = array.origin[row];
  }
  return openvdb::math::Transform::createLinearTransform(map);
}

template <class GridT>
std::shared_ptr<const Volume> volumeOf(const VoxelArray& array, const LoadOptions& options) {
  using Leaf = typename GridT::TreeType::LeafNodeType;
  const ArrayValues<GridT> values{array};
  typename GridT::ValueType background(0.0F);
  if constexpr (!ArrayValues<GridT>::kVector) {
    background = static_cast<typename GridT::ValueType>(array.background ? *array.background
                                                                         : medianOfFaces(values));
  }
  const auto leaves_along = [&](std::size_t a) {
    return static_cast<std::size_t>((array.size[a] + Leaf::DIM - 1) / Leaf::DIM);
  };
  // Each task makes one column of leaves along z.
  const std::size_t columns = leaves_along(0) * leaves_along(1);
  std::vector<std::vector<std::unique_ptr<Leaf>>> made(columns);
  inParallel(columns, [&](std::size_t column) {
    const auto edge = static_cast<std::size_t>(Leaf::DIM);
    const std::size_t x = column / leaves_along(1) * edge;
    const std::size_t y = column % leaves_along(1) * edge;
    for (std::size_t z = 0; z < leaves_along(2); ++z) {
      const openvdb::Coord origin(static_cast<std::int32_t>(x), static_cast<std::int32_t>(y),
                                  static_cast<std::int32_t>(z * edge));
      if (auto leaf = leafOf(values, origin, background)) made[column].push_back(std::move(leaf));
    }
  });
  auto grid = GridT::create(background);
  for (auto& column : made) {
    for (auto& leaf : column) grid->tree().addLeaf(leaf.release());
    column.clear();
  }
  if (grid->empty()) {
    throw VolumeError(array.name,
                      array.vector ? "all its vectors are zero, so no voxel has data"
                                   : "all its values equal the background, so no voxel has data",
                      array.vector ? "give an array with other values"
                      : array.background
                          ? "give an array with other values, or another background"
                          : "give an array with other values, or another background, "
                            "such as 0");
  }
  grid->setName(array.name);
  if (array.level_set) grid->setGridClass(openvdb::GRID_LEVEL_SET);
  try {
    grid->setTransform(transformOf(array));
  } catch (const openvdb::Exception&) {
    throw VolumeError(array.name, "its voxels are too small for OpenVDB",
                      "give it in a smaller unit of length, such as mm instead of m");
  }
  return makeVolume(*grid, options);
}

void check(const VoxelArray& array) {
  if (array.values == nullptr) {
    throw VolumeError(array.name, "it has no values: its address is null",
                      "set VoxelArray::values to the address of value (0, 0, 0)");
  }
  for (std::size_t a = 0; a < 3; ++a) {
    if (array.size[a] >= 1 && array.size[a] <= kMostAlong) continue;
    throw VolumeError(array.name,
                      "it has " + std::to_string(array.size[a]) + " values along axis " +
                          std::to_string(a + 1) + " of 3",
                      "give an array with 1 to 2147483647 values along each of three axes");
  }
  if (array.background && !std::isfinite(*array.background)) {
    throw VolumeError(array.name, "its background is not a finite number",
                      "give the finite number that stands for no data");
  }
  if (array.vector && array.background.value_or(0.0) != 0.0) {
    throw VolumeError(array.name, "its background is a number, and its values are vectors",
                      "omit the background: for vectors it is zero");
  }
  const double volume = std::abs(array.axes.determinant());
  const double edges = array.axes.colwise().norm().prod();
  if (array.axes.allFinite() && array.origin.allFinite() && volume > 1e-9 * edges) return;
  throw VolumeError(array.name, "its voxels have no volume, or its spacing or origin is not finite",
                    "give a finite origin, and a finite spacing above 0 or steps not in one plane");
}

}  // namespace

std::shared_ptr<const Volume> makeVolume(const VoxelArray& array, const LoadOptions& options) {
  check(array);
  const bool single = array.type == VoxelArray::Type::kFloat;
  if (array.vector) {
    return single ? volumeOf<openvdb::Vec3SGrid>(array, options)
                  : volumeOf<openvdb::Vec3DGrid>(array, options);
  }
  return single ? volumeOf<openvdb::FloatGrid>(array, options)
                : volumeOf<openvdb::DoubleGrid>(array, options);
}

}  // namespace palpate
