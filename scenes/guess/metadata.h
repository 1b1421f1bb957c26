/// Private to scenes: metadata of a grid on its values and its space.
#pragma once

#include <string>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

// Names of metadata, as the importer writes them.
inline constexpr const char* kMetaValueUnit = "value_unit";    ///< Unit of the values.
inline constexpr const char* kMetaLengthUnit = "length_unit";  ///< Unit of lengths.
inline constexpr const char* kMetaSpace = "space";             ///< RAS, or absent.

/// Metadata of a file; empty or false if absent.
struct Metadata {
  std::string value_unit;   ///< "HU"
  std::string length_unit;  ///< "mm"
  bool ras = false;         ///< Its space is a patient's: +x right, +y anterior, +z superior.
  bool axial = false;       ///< Vectors without a sign.
  bool mesh = false;        ///< Imported from a mesh: no data outside of its voxels.
};
/// Returns the metadata of a volume; for a vector of three grids, those of the first grid.
[[nodiscard]] Metadata metadataOf(const Volume& volume);

}  // namespace palpate
