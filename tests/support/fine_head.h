/// VTK's CT of a head from PALPATE_DATA, interpolated to a finer grid.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "palpate/engine/types.h"
#include "palpate/samplers/bricks/write_bricks.h"

namespace palpate::test {

/// A CT of a head: 64 x 64 x 93 voxels of 3.2, 3.2 and 1.5 mm. The skin is at the value 500.
/// Between voxels, values are trilinear.
class FineHead {
 public:
  /// Throws std::runtime_error if a slice's file is missing or short.
  /// @param data   Folder PALPATE_DATA.
  /// @param voxel  Edge of the fine voxels [mm]; 0.3 gives 209 million voxels.
  FineHead(const std::filesystem::path& data, double voxel) : voxel_(voxel) {
    values_.reserve(static_cast<std::size_t>(kCount[0]) * kCount[1] * kCount[2]);
    for (int k = 0; k < kCount[2]; ++k) {
      const auto file = data / "ct_headsq" / ("quarter." + std::to_string(k + 1));
      std::ifstream slice(file, std::ios::binary);
      for (int n = 0; n < kCount[0] * kCount[1]; ++n) {
        const int low = slice.get();
        const int high = slice.get();
        values_.push_back(static_cast<float>(low + 256 * high));
      }
      if (!slice) throw std::runtime_error(file.string() + " is missing or short");
    }
  }

  [[nodiscard]] int count(std::size_t a) const {
    return static_cast<int>((kCount[a] - 1) * kSpacing[a] / voxel_) + 1;
  }
  /// Returns the centre of the volume [mm].
  [[nodiscard]] Vec3 centre() const {
    return 0.5 * Vec3((kCount[0] - 1) * kSpacing[0], (kCount[1] - 1) * kSpacing[1],
                      (kCount[2] - 1) * kSpacing[2]);
  }
  [[nodiscard]] float at(const Vec3& p_mm) const {
    std::array<int, 3> i{};
    std::array<float, 3> t{};
    for (std::size_t a = 0; a < 3; ++a) {
      const double x =
          std::clamp(p_mm[static_cast<Eigen::Index>(a)] / kSpacing[a], 0.0, kCount[a] - 1.0);
      i[a] = std::min(static_cast<int>(x), kCount[a] - 2);
      t[a] = static_cast<float>(x - i[a]);
    }
    const auto value = [&](int a, int b, int c) {
      return values_[(static_cast<std::size_t>(i[2] + c) * kCount[1] +
                      static_cast<std::size_t>(i[1] + b)) *
                         kCount[0] +
                     static_cast<std::size_t>(i[0] + a)];
    };
    const auto row = [&](int b, int c) {
      return value(0, b, c) + t[0] * (value(1, b, c) - value(0, b, c));
    };
    const float low = row(0, 0) + t[1] * (row(1, 0) - row(0, 0));
    const float high = row(0, 1) + t[1] * (row(1, 1) - row(0, 1));
    return low + t[2] * (high - low);
  }
  /// Returns the distance from the centre to the outermost skin along a unit vector [mm]. Searches
  /// inwards from 120 mm in steps of 0.2 mm.
  [[nodiscard]] double skin(const Vec3& direction) const {
    double r = 120.0;
    while (r > 1.0 && at(centre() + r * direction) < 500.0F) r -= 0.2;
    return r;
  }
  /// Returns the fine volume as input of a brick writer. This object must outlive the input.
  [[nodiscard]] BrickInput input() const {
    BrickInput out;
    out.name = "density";
    out.grid_class = GridClass::kFog;
    out.linear = voxel_ * Mat3::Identity();
    out.upper = {count(0) - 1, count(1) - 1, count(2) - 1};
    out.identity = "head of " + std::to_string(voxel_);
    out.fill = [this, upper = out.upper](const BrickBox& box) {
      std::size_t n = 0;
      for (int i = 0; i < kBrickEdge; ++i) {
        for (int j = 0; j < kBrickEdge; ++j) {
          for (int k = 0; k < kBrickEdge; ++k, ++n) {
            const VoxelAt v{box.lower[0] + i, box.lower[1] + j, box.lower[2] + k};
            bool in = true;
            for (std::size_t a = 0; a < 3; ++a) in = in && v[a] >= 0 && v[a] <= upper[a];
            box.values[n] = in ? at(voxel_ * Vec3(v[0], v[1], v[2])) : 0.0F;
            if (in) box.active[n / 8] |= static_cast<std::uint8_t>(1U << (n % 8));
          }
        }
      }
      return BoxFilled::kEach;
    };
    return out;
  }
  /// Returns a hand's path around the head in W [m], which begins on the x axis. The path is about
  /// `length` m long, `depth` mm below the skin, and has a position every `step` m. The head has
  /// its real size and is centred at the origin.
  [[nodiscard]] std::vector<Vec3> way(double length, double step, double depth) const {
    std::vector<Vec3> out;
    double angle = 0.0;
    while (static_cast<double>(out.size()) * step < length) {
      // The path rises and falls while it circles the head, so that it rarely visits a point twice.
      const Vec3 d =
          Vec3(std::cos(angle), std::sin(angle), 0.4 * std::sin(1.7 * angle)).normalized();
      // The depth counts from the mean of the nearby skin, because a hand does not follow each
      // fold.
      double r = 0.0;
      for (int n = -4; n <= 4; ++n) {
        const double beside = angle + 0.02 * n;
        r += skin(Vec3(std::cos(beside), std::sin(beside), 0.4 * std::sin(1.7 * beside))
                      .normalized()) /
             9.0;
      }
      const Vec3 p = 1e-3 * (r - depth) * d;
      out.push_back(p);
      angle += 1e3 * step / r;
    }
    return out;
  }

 private:
  static constexpr std::array<int, 3> kCount{64, 64, 93};
  static constexpr std::array<double, 3> kSpacing{3.2, 3.2, 1.5};  // [mm]
  double voxel_;
  std::vector<float> values_;
};

}  // namespace palpate::test
