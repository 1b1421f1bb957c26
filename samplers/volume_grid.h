/// Private to samplers: the OpenVDB side of Volume. Include it in .cpp files only.
#pragma once

#include <array>
#include <mutex>
#include <variant>
#include <vector>

#include <Eigen/LU>
#include <openvdb/openvdb.h>

#include "samplers/volume.h"

namespace palpate {

/// The types that can be felt.
using GridData = std::variant<openvdb::FloatGrid::ConstPtr, openvdb::DoubleGrid::ConstPtr,
                              openvdb::Vec3SGrid::ConstPtr, openvdb::Vec3DGrid::ConstPtr>;

struct Volume::Grid {
  /// A typed grid and its affine map, file = linear * index + origin.
  struct Part {
    GridData data;
    Mat3 linear = Mat3::Identity();
    Vec3 origin = Vec3::Zero();
  };
  /// One, or the x, y and z of a vector: scalars of one type, each at its own place.
  std::vector<Part> parts;

  /// B-spline coefficients of degree 2 and 3, part by part; made once, when first asked for.
  struct Coefficients {
    mutable std::mutex mutex;
    std::vector<GridData> parts;
  };
  mutable std::array<Coefficients, 2> coefficients;
};

}  // namespace palpate
