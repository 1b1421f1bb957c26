/// Private to samplers and scenes, for .cpp files only: the OpenVDB side of Volume.
#pragma once

#include <array>
#include <cstdint>
#include <mutex>
#include <type_traits>
#include <variant>
#include <vector>

#include <Eigen/LU>

#include "palpate/samplers/grid/data_ends.h"
#include "palpate/samplers/grid/free_map.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

using GridData = std::variant<openvdb::FloatGrid::ConstPtr, openvdb::DoubleGrid::ConstPtr,
                              openvdb::Vec3SGrid::ConstPtr, openvdb::Vec3DGrid::ConstPtr>;

/// Types of scalar and vector grids with numbers of the type Real.
template <class Real>
using ScalarGrid =
    std::conditional_t<std::is_same_v<Real, double>, openvdb::DoubleGrid, openvdb::FloatGrid>;
template <class Real>
using VectorGrid =
    std::conditional_t<std::is_same_v<Real, double>, openvdb::Vec3DGrid, openvdb::Vec3SGrid>;

inline std::uint64_t memoryOf(const GridData& data) {
  return std::visit([](const auto& grid) { return grid->memUsage(); }, data);
}

template <class Map>
Box boxAbout(const Box& box, Map map) {
  Box about;
  for (int corner = 0; corner < 8; ++corner) {
    Vec3 p;
    for (int a = 0; a < 3; ++a) p[a] = (((corner >> a) & 1) != 0) ? box.upper[a] : box.lower[a];
    about.extend(map(p));
  }
  return about;
}

struct Volume::Grid {
  /// A grid and its affine map, file = linear * index + origin.
  struct Part {
    GridData data;
    Mat3 linear = Mat3::Identity();
    Vec3 origin = Vec3::Zero();
    DataEnds ends;  ///< Voxels with data.
    /// Distance along each axis by which active voxels extend beyond GridInfo::bounds after
    /// smoothing [voxels].
    Vec3 grown = Vec3::Zero();

    [[nodiscard]] Vec3 toFile(const Vec3& p_I) const { return linear * p_I + origin; }
  };
  /// One grid, or three scalar grids of one type that form a vector, each with its own map.
  std::vector<Part> parts;

  /// B-spline coefficients of degree 2 and 3 for each part, computed at the first request.
  struct Coefficients {
    mutable std::mutex mutex;
    std::vector<GridData> parts;
  };
  mutable std::array<Coefficients, 2> coefficients;

  /// Free maps of the values and of the coefficients of degree 2 and 3, made at the first request.
  struct FreeMaps {
    mutable std::mutex mutex;
    std::vector<std::shared_ptr<const FreeMap>> parts;
  };
  mutable std::array<FreeMaps, 3> free_maps;
};

}  // namespace palpate
