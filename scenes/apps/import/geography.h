/// Converts grids of the atmosphere and the ocean to volumes.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

enum class Along : std::uint8_t {
  kOther,      ///< Other positions in `unit`, or indices.
  kLongitude,  ///< Longitude [degrees].
  kLatitude,   ///< Latitude [degrees].
  kPressure,   ///< Pressure [hPa].
  kDepth,      ///< Depth, positive downwards, in `unit`.
  kNumber,     ///< Numbers of levels whose heights are unknown, as in a model.
};

struct Axis {
  Along along = Along::kOther;
  std::vector<double> at;
  std::string unit;  ///< As the file states it; empty: not stated.
};

/// Fields on one grid. Values are in the order of `axes`, the first axis fastest.
struct EarthGrid {
  std::array<Axis, 3> axes;
  /// True if x and y are coordinates of a map projection, such as Lambert's.
  bool projected = false;
  std::vector<Array> arrays;
  std::vector<std::string> standard;  ///< CF standard_name of each array; may be empty.
};

/// Returns the size of a unit of pressure [hPa]: hPa, mb, mbar, millibar, millibars, Pa or kPa. 0
/// for all other units, also for bar, atm, and decibar, by which oceanographers state depths.
[[nodiscard]] double hectopascals(const std::string& unit);

/// Converts a grid to pieces: an image if its points form an even lattice, otherwise a mesh.
///
/// If x is longitude and y is latitude, they become km on a plane, at the scale of the middle
/// latitude. On such a grid and on a map projection, pressures become heights in the standard
/// atmosphere (ISO 2533). If the range of heights there is below a quarter of the longer horizontal
/// side, all heights are multiplied by a round number. The range is then at least a quarter.
/// Components of wind or current become one vector, whose z component is multiplied by the same
/// number. Adds a note for each change. Throws VolumeError if positions along an axis are not
/// finite, or neither increase nor decrease. Also throws if a longitude or latitude is out of
/// range.
[[nodiscard]] std::vector<Piece> earthPieces(EarthGrid grid, const std::vector<std::string>& fields,
                                             const std::string& file, Content& content);

}  // namespace palpate::importer
