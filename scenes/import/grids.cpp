#include "scenes/import/grids.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <mutex>
#include <type_traits>

#include <Eigen/LU>
#include <tbb/parallel_for.h>
#include <vtkBitArray.h>
#include <vtkSetGet.h>
#include <vtkUnsignedCharArray.h>

#include "engine/error.h"

namespace palpate::importer {
namespace {

using openvdb::Coord;

/// Native values of an image, C a point.
template <class T, int C>
struct Values {
  const T* data = nullptr;

  using Value = std::conditional_t<C == 1, float, openvdb::Vec3f>;

  [[nodiscard]] Value operator[](std::size_t point) const {
    if constexpr (C == 1) {
      return static_cast<float>(data[point]);
    } else {
      const T* v = data + 3 * point;
      return {static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])};
    }
  }
};

bool isFinite(float v) {
  return std::isfinite(v);
}
bool isFinite(const openvdb::Vec3f& v) {
  return std::isfinite(v.x()) && std::isfinite(v.y()) && std::isfinite(v.z());
}
double sizeOf(float v) {
  return v;
}
double sizeOf(const openvdb::Vec3f& v) {
  return openvdb::Vec3d(v).length();
}
bool isNear(float a, float b, double tolerance) {
  return std::abs(static_cast<double>(a) - static_cast<double>(b)) <= tolerance;
}
bool isNear(const openvdb::Vec3f& a, const openvdb::Vec3f& b, double tolerance) {
  return (openvdb::Vec3d(a) - openvdb::Vec3d(b)).length() <= tolerance;
}

bool isHidden(const Piece& image, std::size_t point) {
  return image.hidden != nullptr && image.hidden->GetValue(static_cast<vtkIdType>(point)) != 0;
}

std::size_t pointAt(const Piece& image, int i, int j, int k) {
  return (static_cast<std::size_t>(k) * static_cast<std::size_t>(image.size[1]) +
          static_cast<std::size_t>(j)) *
             static_cast<std::size_t>(image.size[0]) +
         static_cast<std::size_t>(i);
}

/// What the object stands in.
struct Surroundings {
  float middle = 0.0F;  ///< The median of the values on the image's faces.
  float spread = 0.0F;  ///< 99 % of them are this near to it.
};

template <class T>
Surroundings surroundingsOf(const Piece& image, const Values<T, 1>& values) {
  std::vector<float> faces;
  const auto& n = image.size;
  for (int k = 0; k < n[2]; ++k) {
    for (int j = 0; j < n[1]; ++j) {
      const bool outer = k == 0 || k == n[2] - 1 || j == 0 || j == n[1] - 1;
      const int step = outer || n[0] == 1 ? 1 : n[0] - 1;
      for (int i = 0; i < n[0]; i += step) {
        const std::size_t point = pointAt(image, i, j, k);
        const float value = values[point];
        if (std::isfinite(value) && !isHidden(image, point)) faces.push_back(value);
      }
    }
  }
  Surroundings out;
  if (faces.empty()) return out;
  const auto at = [&](double share) {
    const auto place =
        faces.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(faces.size() - 1));
    std::nth_element(faces.begin(), place, faces.end());
    return *place;
  };
  out.middle = at(0.5);
  for (float& value : faces) value = std::abs(value - out.middle);
  out.spread = at(0.99);
  return out;
}

/// What the workers found, put together.
struct Sums {
  std::mutex mutex;
  std::uint64_t holes = 0;
  std::uint64_t loud = 0;  ///< Voxels that differ from the surroundings by more than these do.
  double lowest = std::numeric_limits<double>::infinity();
  double highest = -std::numeric_limits<double>::infinity();
};

template <class T, int C>
Gridded build(const Piece& image, const Array& array, double tolerance, const Progress& progress) {
  using Value = typename Values<T, C>::Value;
  using GridT = std::conditional_t<C == 1, openvdb::FloatGrid, openvdb::Vec3SGrid>;
  using Leaf = typename GridT::TreeType::LeafNodeType;
  const Values<T, C> values{static_cast<const T*>(array.values->GetVoidPointer(0))};
  Value background(0.0F);
  Surroundings surroundings;
  if constexpr (C == 1) {
    surroundings = surroundingsOf(image, values);
    background = surroundings.middle;
  }

  // A row of leaves along j a task; each leaf is filled whole, and kept where a voxel is active.
  constexpr int kEdge = static_cast<int>(Leaf::DIM);
  const std::array<int, 3> leaves{(image.size[0] + kEdge - 1) / kEdge,
                                  (image.size[1] + kEdge - 1) / kEdge,
                                  (image.size[2] + kEdge - 1) / kEdge};
  const int rows = leaves[0] * leaves[2];
  std::vector<std::vector<std::unique_ptr<Leaf>>> made(static_cast<std::size_t>(rows));
  Sums sums;
  std::atomic<int> done{0};
  std::mutex telling;
  tbb::parallel_for(0, rows, [&](int row) {
    std::uint64_t holes = 0;
    std::uint64_t loud = 0;
    double lowest = std::numeric_limits<double>::infinity();
    double highest = -lowest;
    for (int y = 0; y < leaves[1]; ++y) {
      const Coord origin((row % leaves[0]) * kEdge, y * kEdge, (row / leaves[0]) * kEdge);
      auto leaf = std::make_unique<Leaf>(origin, background);
      const Coord end(std::min(origin.x() + kEdge, image.size[0]),
                      std::min(origin.y() + kEdge, image.size[1]),
                      std::min(origin.z() + kEdge, image.size[2]));
      for (int k = origin.z(); k < end.z(); ++k) {
        for (int j = origin.y(); j < end.y(); ++j) {
          for (int i = origin.x(); i < end.x(); ++i) {
            const std::size_t point = pointAt(image, i, j, k);
            const Value value = values[point];
            if (!isFinite(value) || isHidden(image, point)) {
              ++holes;
              continue;
            }
            if (isNear(value, background, tolerance)) continue;
            leaf->setValueOn(Leaf::coordToOffset(Coord(i, j, k)), value);
            if (!isNear(value, background, surroundings.spread)) ++loud;
            lowest = std::min(lowest, sizeOf(value));
            highest = std::max(highest, sizeOf(value));
          }
        }
      }
      if (!leaf->isEmpty()) made[static_cast<std::size_t>(row)].push_back(std::move(leaf));
    }
    {
      const std::lock_guard lock(sums.mutex);
      sums.holes += holes;
      sums.loud += loud;
      sums.lowest = std::min(sums.lowest, lowest);
      sums.highest = std::max(sums.highest, highest);
    }
    const int count = ++done;
    if (progress && telling.try_lock()) {
      progress(static_cast<double>(count) / rows);
      telling.unlock();
    }
  });

  auto grid = GridT::create(background);
  for (auto& row : made) {
    for (auto& leaf : row) grid->tree().addLeaf(leaf.release());
    row.clear();
  }
  Gridded out;
  out.grid = grid;
  out.voxels = static_cast<std::uint64_t>(array.values->GetNumberOfTuples());
  out.holes = sums.holes;
  out.lowest = sums.lowest;
  out.highest = sums.highest;
  out.background = sizeOf(background);
  out.tolerance = tolerance;
  const double share = static_cast<double>(sums.loud) / static_cast<double>(out.voxels);
  const double range = std::max(out.highest, out.background) - std::min(out.lowest, out.background);
  const auto active = static_cast<double>(grid->activeVoxelCount());
  if (surroundings.spread > tolerance && surroundings.spread < 0.05 * range &&
      share * static_cast<double>(out.voxels) < 0.9 * active) {
    out.quieter_tolerance = surroundings.spread;
    out.quieter_share = share;
  }
  return out;
}

template <int C>
Gridded buildAny(const Piece& image, const Array& array, double tolerance,
                 const Progress& progress) {
  switch (array.values->GetDataType()) {
    vtkTemplateMacro(return (build<VTK_TT, C>(image, array, tolerance, progress)));
    default:
      throw VolumeError(array.name, "its values are no numbers", "choose another with --field");
  }
}

}  // namespace

Gridded gridFromImage(const Piece& image, const Array& array, double tolerance,
                      const Progress& progress) {
  Gridded out = array.values->GetNumberOfComponents() == 1
                    ? buildAny<1>(image, array, tolerance, progress)
                    : buildAny<3>(image, array, tolerance, progress);
  out.grid->setName(array.name);
  return out;
}

openvdb::math::Transform::Ptr transformOf(const Affine& file_from_index, const std::string& file) {
  const Mat3& M = file_from_index.linear;
  const double volume = std::abs(M.determinant());
  const double edges = M.col(0).norm() * M.col(1).norm() * M.col(2).norm();
  if (!M.allFinite() || !file_from_index.origin.allFinite() || !(volume > 1e-9 * edges)) {
    throw VolumeError(file, "its voxels have no volume: the spacing or the directions are wrong",
                      "mend its header");
  }
  openvdb::Mat4R map;  // OpenVDB's convention: row vectors
  map.setIdentity();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) map(column, row) = M(row, column);
    map(3, row) = file_from_index.origin[row];
  }
  return openvdb::math::Transform::createLinearTransform(map);
}

}  // namespace palpate::importer
