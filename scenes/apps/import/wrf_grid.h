/// Private to the importer: finds the positions of points in WRF's files.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "palpate/scenes/apps/import/netcdf_file.h"

namespace palpate::importer {

struct WrfGrid {
  int x = -1;  ///< Index of the file's dimension west_east; `y` is that of south_north.
  int y = -1;
  int z = -1;       ///< Index of bottom_top; -1: no levels.
  double dx = 0.0;  ///< Spacing along x on the plane of the map projection [m]; `dy` along y.
  double dy = 0.0;
  /// Mean height of each level's centre above the sea, at the first time [m]; empty: unknown.
  std::vector<double> heights;
  std::vector<std::string> notes;
};

/// Returns the grid of a file with WRF's dimensions; no value for other files, or if the spacing is
/// unknown. The spacing is that of the attributes DX and DY, otherwise the mean distance between
/// neighbouring points at XLAT and XLONG. A height is the geopotential PH + PHB divided by the
/// gravity of WRF. Throws VolumeError if the file is damaged.
[[nodiscard]] std::optional<WrfGrid> wrfGridOf(const NetcdfFile& file);

}  // namespace palpate::importer
