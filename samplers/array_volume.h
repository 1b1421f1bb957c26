/// Values that a program has in memory, on a regular lattice, as a volume that can be felt: no
/// header of OpenVDB's.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "palpate/engine/types.h"
#include "palpate/samplers/volume.h"

namespace palpate {

/// A view of an array of scalars or of vectors, in any order in memory. The value (i, j, k) stands
/// at origin + axes (i, j, k) of the volume's own space.
struct VoxelArray {
  /// What a scalar, or a component of a vector, is stored as: 32 or 64 bits.
  enum class Type : std::uint8_t { kFloat, kDouble };

  const void* values = nullptr;            ///< Of (0, 0, 0), at any address; read, never kept.
  Type type = Type::kFloat;                ///< Of the array, and of the grid that is made of it.
  bool vector = false;                     ///< Three components a value, in W's order.
  std::array<std::int64_t, 3> size{};      ///< Values along i, j and k, each > 0.
  std::array<std::ptrdiff_t, 3> stride{};  ///< From one to the next along each [bytes].
  std::ptrdiff_t component_stride = 0;     ///< From one component to the next [bytes].
  Mat3 axes = Mat3::Identity();            ///< Columns: steps along i, j and k, in its own units.
  Vec3 origin = Vec3::Zero();              ///< In its own units.
  std::string name = "values";             ///< For errors and messages.
  bool level_set = false;                  ///< Signed distances, negative within: the surface is 0.
  /// What is there where nothing is; values equal to it are no data. None: of a scalar the median
  /// of the values on the array's six faces, as `palpate import` takes it; of a vector zero.
  std::optional<double> background;
};

/// Copies the values and has them checked as a file's (loadVolume). Throws VolumeError, by the
/// array's name, for sizes that are not 1 to 2^31 - 1, for axes without a volume, and for what
/// cannot be felt. Slow: looks at every value, in parallel.
[[nodiscard]] std::shared_ptr<const Volume> makeVolume(const VoxelArray& array,
                                                       const LoadOptions& options = {});

}  // namespace palpate
