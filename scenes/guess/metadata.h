/// Private to scenes: reads a grid's metadata about its values and its space.
#pragma once

#include <string>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

// Keys of metadata that the importer writes.
inline constexpr const char* kMetaValueUnit = "value_unit";    ///< Unit of the values.
inline constexpr const char* kMetaLengthUnit = "length_unit";  ///< Unit of lengths.
inline constexpr const char* kMetaSpace = "space";             ///< "RAS", or absent.

/// Metadata of a grid. Absent entries are empty or false.
struct Metadata {
  std::string value_unit;   ///< For example "HU".
  std::string length_unit;  ///< For example "mm".
  /// True if the space is that of a patient: +x right, +y anterior, +z superior.
  bool ras = false;
  bool axial = false;  ///< True if vectors v and -v mean the same.
  /// True if the grid was imported from a mesh: the inactive voxels are outside of the data.
  bool mesh = false;
};
/// Returns the metadata of a volume, or of the first grid of a vector in three grids.
[[nodiscard]] Metadata metadataOf(const Volume& volume);

}  // namespace palpate
