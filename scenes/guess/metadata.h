/// Private to scenes: reads metadata of a grid about its values and its space.
#pragma once

#include <string>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

// Names of metadata entries that the importer writes.
inline constexpr const char* kMetaValueUnit = "value_unit";    ///< Unit of the values.
inline constexpr const char* kMetaLengthUnit = "length_unit";  ///< Unit of lengths.
inline constexpr const char* kMetaSpace = "space";             ///< "RAS", or absent.

/// Metadata of a grid. An absent entry is empty or false.
struct Metadata {
  std::string value_unit;   ///< For example "HU".
  std::string length_unit;  ///< For example "mm".
  /// True if the space is that of a patient: +x right, +y anterior, +z superior.
  bool ras = false;
  bool axial = false;  ///< True if the sign of the vectors has no meaning.
  /// True if imported from a mesh: the grid has no data outside of its active voxels.
  bool mesh = false;
};
/// Returns the metadata of a volume, or of the first grid of a vector in three grids.
[[nodiscard]] Metadata metadataOf(const Volume& volume);

}  // namespace palpate
