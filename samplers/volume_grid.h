/// Private to samplers: the OpenVDB side of Volume. Include it in .cpp files only.
#pragma once

#include <variant>

#include <Eigen/LU>
#include <openvdb/openvdb.h>

#include "samplers/volume.h"

namespace palpate {

/// A typed grid and its affine map, file = linear * index + origin.
struct Volume::Grid {
  std::variant<openvdb::FloatGrid::ConstPtr, openvdb::DoubleGrid::ConstPtr,
               openvdb::Vec3SGrid::ConstPtr, openvdb::Vec3DGrid::ConstPtr>
      data;
  Mat3 linear = Mat3::Identity();
  Vec3 origin = Vec3::Zero();
};

}  // namespace palpate
