/// Copies an array in memory into a volume. Includes no OpenVDB header.
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

/// View of an array of scalars or vectors on a regular lattice, in any memory order. Value (i, j,
/// k) is at origin + axes (i, j, k) in the array's own space.
struct VoxelArray {
  /// Storage type of a scalar, or of a vector's component: 32 or 64 bits.
  enum class Type : std::uint8_t { kFloat, kDouble };

  /// Address of value (0, 0, 0), not null, with any alignment. The array is read during the call
  /// only.
  const void* values = nullptr;
  Type type = Type::kFloat;  ///< Type of the numbers in the array, and in the grid made from it.
  bool vector = false;       ///< True if a value has the components x, y and z, in this order.
  std::array<std::int64_t, 3> size{};  ///< Number of values along i, j and k, each > 0.
  /// Distance in memory to the next value along each axis [bytes].
  std::array<std::ptrdiff_t, 3> stride{};
  /// Distance in memory to the next component of a vector [bytes].
  std::ptrdiff_t component_stride = 0;
  /// Columns: steps along i, j and k, in the array's unit of length.
  Mat3 axes = Mat3::Identity();
  Vec3 origin = Vec3::Zero();   ///< Position of value (0, 0, 0), in the array's unit of length.
  std::string name = "values";  ///< Name of the volume, used in messages.
  bool level_set = false;  ///< True for signed distances, negative inside. The surface is at 0.
  /// Value outside of the array. Array elements with this value have no data. If not set: zero for
  /// vectors; for scalars the median of the finite values on the array's six faces, as in
  /// `palpate import`, or 0 if no value there is finite. Must not be set for vectors, except to 0.
  std::optional<double> background;
};

/// Copies the values, and checks them as loadVolume checks a file. Throws VolumeError, with the
/// array's name, in these cases. `values` is null. A size is not within 1 to 2^31 - 1. The axes do
/// not span a volume, are too small for OpenVDB, or are not finite. The origin or the background is
/// not finite, or vectors have a background. All values equal the background. Or loadVolume would
/// reject the values. Slow: reads every value, in parallel.
[[nodiscard]] std::shared_ptr<const Volume> makeVolume(const VoxelArray& array,
                                                       const LoadOptions& options = {});

}  // namespace palpate
