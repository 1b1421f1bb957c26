/// Makes dense bricks from a formula, without the volume in memory.
#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <string>

#include "palpate/samplers/bricks/write_bricks.h"

namespace palpate::test {

/// Returns the input of a brick writer: voxels [0, upper] with edges of 1, all active, and with the
/// values value(index).
inline BrickInput formulaBricks(const std::string& name, const VoxelAt& upper,
                                const std::function<double(const VoxelAt&)>& value) {
  BrickInput out;
  out.name = name;
  out.grid_class = GridClass::kFog;
  out.upper = upper;
  out.identity = name;
  out.fill = [value](const BrickBox& box) {
    std::size_t n = 0;
    for (int i = 0; i < kBrickEdge; ++i) {
      for (int j = 0; j < kBrickEdge; ++j) {
        for (int k = 0; k < kBrickEdge; ++k, ++n) {
          box.values[n] =
              static_cast<float>(value({box.lower[0] + i, box.lower[1] + j, box.lower[2] + k}));
        }
      }
    }
    std::fill(box.active.begin(), box.active.end(), std::uint8_t{0xFF});
    return BoxFilled::kEach;
  };
  return out;
}

}  // namespace palpate::test
