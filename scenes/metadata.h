/// Private to scenes: what a grid's metadata say of its values and its space.
#pragma once

#include <string>

#include "palpate/samplers/volume.h"

namespace palpate {

// Names of metadata, as the importer writes them.
inline constexpr const char* kMetaValueUnit = "value_unit";    ///< Of the values.
inline constexpr const char* kMetaLengthUnit = "length_unit";  ///< Of places.
inline constexpr const char* kMetaSpace = "space";             ///< RAS, or none.

/// What the file says; empty or false where it does not.
struct Metadata {
  std::string value_unit;   ///< "HU"
  std::string length_unit;  ///< "mm"
  bool ras = false;         ///< Its space is a patient's: +x right, +y anterior, +z superior.
  bool axial = false;       ///< Vectors whose sign means nothing.
  bool mesh = false;        ///< Imported from a mesh: outside of its voxels nothing is known.
};
/// Of a vector by component, what its first says.
[[nodiscard]] Metadata metadataOf(const Volume& volume);

}  // namespace palpate
