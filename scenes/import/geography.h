/// Grids of the earth, laid out so that they can be felt: what NetCDF and GRIB have in common.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// What the positions of an axis are.
enum class Along : std::uint8_t {
  kOther,      ///< Positions in `unit`, or numbers.
  kLongitude,  ///< [degrees]
  kLatitude,   ///< [degrees]
  kPressure,   ///< [hPa]
  kDepth,      ///< Downwards, in `unit`.
  kNumber,     ///< Levels that have a number and no height, as of a model.
};

struct Axis {
  Along along = Along::kOther;
  std::vector<double> at;
  std::string unit;  ///< Of length: m or km; else as the file says.
};

/// Fields of one grid. Values are ordered as `axes`: the first is the fastest.
struct EarthGrid {
  std::array<Axis, 3> axes;  ///< x, y, z
  bool projected = false;    ///< x and y are a map's, as Lambert's.
  std::vector<Array> arrays;
  std::vector<std::string> standard;  ///< CF's standard_name of each array, or empty.
};

/// What GRIB and CF call units of pressure: how many hPa one is; 0: no pressure.
[[nodiscard]] double hectopascals(const std::string& unit);

/// One grid as a piece: an image where its points stand as one's, else a mesh. Longitudes and
/// latitudes become km on a plane, at the scale of the middle latitude; pressures the height that
/// they have in the standard atmosphere (ISO 2533). Heights over such a plane are stretched, by a
/// round number, so that they are a quarter of its longer side: else a hand would feel a sheet.
/// Pairs and triples of wind or current become one vector, whose z is stretched with the heights.
/// Sets the unit of length; all that was done is said in `notes`. Throws VolumeError where
/// positions are in no order.
[[nodiscard]] std::vector<Piece> earthPieces(EarthGrid grid, const std::vector<std::string>& fields,
                                             const std::string& file, Content& content);

}  // namespace palpate::importer
