#include "palpate/scenes/apps/import/wrf_grid.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>

#include <fmt/format.h>

namespace palpate::importer {
namespace {

/// Reads a variable at the first time, at all indices of the dimensions in `whole`, and at index
/// `at` of all others.
std::vector<double> readSlice(const NetcdfFile& file, int v, const std::vector<int>& whole,
                              std::size_t at) {
  std::vector<std::size_t> start;
  std::vector<std::size_t> count;
  double values = 1.0;
  for (const int d : file.variable(v).dimensions) {
    const bool all = std::find(whole.begin(), whole.end(), d) != whole.end();
    start.push_back(all || file.dimension(d).is == Is::kTime ? 0 : at);
    count.push_back(all ? file.dimension(d).length : 1);
    values *= static_cast<double>(count.back());
  }
  file.checkAbsurd(values);
  std::vector<double> out(static_cast<std::size_t>(values));
  file.read(v, start, count, out.data());
  return out;
}

/// Returns the length of the great circle between two points [m].
double greatCircle(double lon0, double lat0, double lon1, double lat1) {
  constexpr double kRadius = 6371e3;  // [m]: mean radius of the earth
  constexpr double kRadians = std::numbers::pi / 180.0;
  const double north = std::sin(0.5 * kRadians * (lat1 - lat0));
  const double east = std::sin(0.5 * kRadians * (lon1 - lon0));
  const double half =
      north * north + std::cos(kRadians * lat0) * std::cos(kRadians * lat1) * east * east;
  return 2.0 * kRadius * std::asin(std::sqrt(std::clamp(half, 0.0, 1.0)));
}

struct Spread {
  double mean = 0.0;
  double most = 0.0;
};
Spread spreadOf(const std::vector<double>& numbers) {
  Spread out;
  for (const double x : numbers) out.mean += x / static_cast<double>(numbers.size());
  for (const double x : numbers) out.most = std::max(out.most, std::abs(x - out.mean));
  return out;
}

/// Sets the spacing to the mean distance of neighbouring points. Returns false if the file lacks
/// valid longitudes or latitudes.
bool takeSpacingFromPlaces(const NetcdfFile& file, WrfGrid& grid) {
  const int lon_at = file.variableNamed("XLONG");
  const int lat_at = file.variableNamed("XLAT");
  const std::vector<int> plane{grid.y, grid.x};
  for (const int v : {lon_at, lat_at}) {
    if (v < 0 || file.spaceOf(v) != plane || file.variable(v).type > NC_DOUBLE ||
        file.variable(v).type == NC_CHAR) {
      return false;
    }
  }
  const std::vector<double> lon = readSlice(file, lon_at, plane, 0);
  const std::vector<double> lat = readSlice(file, lat_at, plane, 0);
  const std::size_t columns = file.dimension(grid.x).length;
  std::vector<double> along_x;
  std::vector<double> along_y;
  for (std::size_t i = 0; i < lon.size(); ++i) {
    const auto to = [&](std::size_t other) {
      return greatCircle(lon[i], lat[i], lon[other], lat[other]);
    };
    if ((i + 1) % columns != 0) along_x.push_back(to(i + 1));
    if (i + columns < lon.size()) along_y.push_back(to(i + columns));
  }
  const Spread x = spreadOf(along_x);
  const Spread y = spreadOf(along_y);
  if (!(x.mean > 0.0 && y.mean > 0.0)) return false;
  grid.dx = x.mean;
  grid.dy = y.mean;
  grid.notes.push_back(fmt::format(
      "the spacing is the mean distance between the points at XLAT and XLONG: {:.4g} km by {:.4g} "
      "km; single distances differ from the mean by up to {:.2g} %",
      1e-3 * x.mean, 1e-3 * y.mean, 100.0 * std::max(x.most / x.mean, y.most / y.mean)));
  return true;
}

/// Sets the heights of levels from the geopotential at their faces, if the file has it.
void takeHeights(const NetcdfFile& file, WrfGrid& grid) {
  constexpr double kGravity = 9.81;  // [m/s^2]: WRF's constant g (share/module_model_constants.F)
  const int faces = file.dimensionNamed("bottom_top_stag");
  const int change = file.variableNamed("PH");
  const int base = file.variableNamed("PHB");
  const std::vector<int> space{faces, grid.y, grid.x};
  if (faces < 0 || file.centresOf(faces) != grid.z || change < 0 || base < 0 ||
      file.spaceOf(change) != space || file.spaceOf(base) != space) {
    return;
  }
  const std::vector<int> plane{grid.y, grid.x};
  std::vector<double> below;
  double most = 0.0;
  for (std::size_t k = 0; k < file.dimension(faces).length; ++k) {
    std::vector<double> here = readSlice(file, change, plane, k);
    const std::vector<double> more = readSlice(file, base, plane, k);
    for (std::size_t i = 0; i < here.size(); ++i) here[i] = (here[i] + more[i]) / kGravity;
    if (k > 0) {
      for (std::size_t i = 0; i < here.size(); ++i) below[i] = 0.5 * (below[i] + here[i]);
      const Spread level = spreadOf(below);
      grid.heights.push_back(level.mean);
      most = std::max(most, level.most);
    }
    below = std::move(here);
  }
  grid.notes.push_back(fmt::format(
      "levels lie at their mean heights, from PH and PHB at the first time; the height of a point "
      "differs from the level's mean by up to {:.3g} km",
      1e-3 * most));
}

}  // namespace

std::optional<WrfGrid> wrfGridOf(const NetcdfFile& file) {
  WrfGrid grid;
  grid.x = file.dimensionNamed("west_east");
  grid.y = file.dimensionNamed("south_north");
  grid.z = file.dimensionNamed("bottom_top");
  if (grid.x < 0 || grid.y < 0) return std::nullopt;
  const std::vector<double> dx = file.numbers(NC_GLOBAL, "DX");
  const std::vector<double> dy = file.numbers(NC_GLOBAL, "DY");
  const auto is_spacing = [](const std::vector<double>& d) {
    return d.size() == 1 && d[0] > 0.0 && std::isfinite(d[0]);
  };
  if (is_spacing(dx) && is_spacing(dy)) {
    grid.dx = dx[0];
    grid.dy = dy[0];
  } else if (!takeSpacingFromPlaces(file, grid)) {
    return std::nullopt;
  }
  takeHeights(file, grid);
  return grid;
}

}  // namespace palpate::importer
