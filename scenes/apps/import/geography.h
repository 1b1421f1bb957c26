/// Converts grids of the earth to volumes for haptics.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Meaning of the positions along an axis.
enum class Along : std::uint8_t {
  kOther,      ///< Positions in `unit`, or numbers.
  kLongitude,  ///< [degrees]
  kLatitude,   ///< [degrees]
  kPressure,   ///< [hPa]
  kDepth,      ///< Downwards, in `unit`.
  kNumber,     ///< Levels with a number but no height, as in a model.
};

struct Axis {
  Along along = Along::kOther;
  std::vector<double> at;
  std::string unit;  ///< Unit of the positions, as in the file.
};

/// Fields on one grid. Values are ordered as `axes`: the first axis is the fastest.
struct EarthGrid {
  std::array<Axis, 3> axes;  ///< x, y, z
  bool projected = false;    ///< x and y belong to a map projection, such as Lambert's.
  std::vector<Array> arrays;
  std::vector<std::string> standard;  ///< The CF standard_name of each array, or empty.
};

/// Returns how many hPa one unit is, for the names that CF uses; 0: not a pressure.
[[nodiscard]] double hectopascals(const std::string& unit);

/// Converts one grid to pieces: an image if its points lie on an image's lattice, else a mesh.
/// Longitudes and latitudes become km on a plane, at the scale of the middle latitude. Pressures
/// become heights in the standard atmosphere (ISO 2533). Heights over this plane are stretched by a
/// round number, so that they are at least a quarter of its longer side. Otherwise the
/// volume would be a flat sheet. Pairs and triples of wind or current become one vector, whose z is
/// stretched with the heights. Sets the unit of length, and lists all changes in `notes`. Throws
/// VolumeError if positions along an axis are not in order.
[[nodiscard]] std::vector<Piece> earthPieces(EarthGrid grid, const std::vector<std::string>& fields,
                                             const std::string& file, Content& content);

}  // namespace palpate::importer
