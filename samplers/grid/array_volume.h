/// Copies an array in memory (values on a regular lattice) into a volume that a hand can feel. Does
/// not include OpenVDB headers.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "palpate/engine/types.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// A view of an array of scalars or of vectors, in any memory order. In the volume's own space,
/// value (i, j, k) is at origin + axes (i, j, k).
struct VoxelArray {
  /// Storage type of a scalar, or of a vector's component: 32 or 64 bits.
  enum class Type : std::uint8_t { kFloat, kDouble };

  const void* values = nullptr;            ///< Value (0, 0, 0), at any address; read, not kept.
  Type type = Type::kFloat;                ///< Type of the array, and of the grid made from it.
  bool vector = false;                     ///< Three components a value, in W's order.
  std::array<std::int64_t, 3> size{};      ///< Values along i, j and k, each > 0.
  std::array<std::ptrdiff_t, 3> stride{};  ///< Step to the next value along each axis [bytes].
  std::ptrdiff_t component_stride = 0;     ///< Step to the next component [bytes].
  Mat3 axes = Mat3::Identity();            ///< Columns: steps along i, j and k, in own units.
  Vec3 origin = Vec3::Zero();              ///< Place of value (0, 0, 0), in own units.
  std::string name = "values";             ///< Used in errors and messages.
  bool level_set = false;                  ///< Signed distances, negative inside; the surface is 0.
  /// Value of places without data; values equal to it are not data. If not set: for scalars the
  /// median of the values on the array's six faces, as in `palpate import`; for vectors zero.
  std::optional<double> background;
};

/// Copies the values and checks them as loadVolume checks a file. Throws VolumeError, under the
/// array's name, for sizes outside 1 to 2^31 - 1, for axes without a volume, and for values that
/// cannot be felt. Slow: reads every value, in parallel.
[[nodiscard]] std::shared_ptr<const Volume> makeVolume(const VoxelArray& array,
                                                       const LoadOptions& options = {});

}  // namespace palpate
