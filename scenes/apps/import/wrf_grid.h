/// Private to the importer: the places of the points of WRF's files. Such a file states the spacing
/// along its rows and columns, and the longitude and the latitude of each point.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "palpate/scenes/apps/import/netcdf_file.h"

namespace palpate::importer {

struct WrfGrid {
  int x = -1;  ///< Index of the dimension of the rows; `y` is that of the columns.
  int y = -1;
  int z = -1;       ///< Index of the dimension of the levels; -1: none.
  double dx = 0.0;  ///< Spacing along x on the plane of the map projection [m]; `dy` along y.
  double dy = 0.0;
  /// Mean height of each level's centre above the sea at the first time [m]; empty: not in the
  /// file.
  std::vector<double> heights;
  std::vector<std::string> notes;  ///< Assumptions, one line each.
};

/// Returns the grid of a file with WRF's dimensions `west_east` and `south_north`; no value for
/// other files, and if the file does not state the spacing. The spacing is that of the attributes
/// DX and DY, else the mean distance between the points at XLAT and XLONG. Heights are those of the
/// geopotential, PH + PHB. Throws VolumeError if the file is damaged.
[[nodiscard]] std::optional<WrfGrid> wrfGridOf(const NetcdfFile& file);

}  // namespace palpate::importer
