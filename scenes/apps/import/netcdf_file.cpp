#include "palpate/scenes/apps/import/netcdf_file.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <initializer_list>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/geography.h"
#include "palpate/scenes/apps/import/grids.h"
#include "palpate/scenes/apps/import/header_checks.h"

namespace palpate::importer {
namespace {

/// Returns the text of an attribute in a file or group, without spaces at its end. Returns "" if
/// the attribute is absent, is not a text, or is an array of more than 4096 characters. Cuts a
/// string of netCDF-4 to 4096 bytes.
std::string textIn(int id, int variable, const char* name) {
  nc_type type = NC_NAT;
  std::size_t length = 0;
  if (nc_inq_att(id, variable, name, &type, &length) != NC_NOERR) return "";
  std::string out;
  constexpr std::size_t kLongest = 4096;
  if (type == NC_CHAR && length <= kLongest) {
    out.resize(length);
    if (nc_get_att_text(id, variable, name, out.data()) != NC_NOERR) return "";
  } else if (type == NC_STRING && length == 1) {
    char* string = nullptr;
    if (nc_get_att_string(id, variable, name, &string) != NC_NOERR) return "";
    if (string != nullptr) out = std::string(string).substr(0, kLongest);
    nc_free_string(1, &string);
  }
  while (!out.empty() && (out.back() == '\0' || out.back() == ' ')) out.pop_back();
  return out;
}

bool hasPart(const std::string& text, std::string_view what) {
  return text.find(what) != std::string::npos;
}

}  // namespace

NetcdfFile::NetcdfFile(const std::filesystem::path& path) : path_(path) {
  check(nc_open(path.c_str(), NC_NOWRITE, &id_));
  int dimensions = 0;
  int variables = 0;
  int unlimited = -1;
  check(nc_inq(id_, &dimensions, &variables, nullptr, &unlimited));
  std::array<char, NC_MAX_NAME + 1> name{};
  for (int d = 0; d < dimensions; ++d) {
    Dimension dimension;
    check(nc_inq_dim(id_, d, name.data(), &dimension.length));
    dimension.name = name.data();
    if (d == unlimited) dimension.is = Is::kTime;
    dimensions_.push_back(std::move(dimension));
  }
  for (int v = 0; v < variables; ++v) {
    Variable variable;
    int rank = 0;
    check(nc_inq_varndims(id_, v, &rank));
    variable.dimensions.resize(static_cast<std::size_t>(rank));
    check(nc_inq_var(id_, v, name.data(), &variable.type, nullptr, variable.dimensions.data(),
                     nullptr));
    variable.name = name.data();
    for (const int d : variable.dimensions) {
      if (d < 0 || d >= dimensions)
        refuse(fmt::format("the dimensions of the variable {} are invalid", variable.name));
    }
    variables_.push_back(std::move(variable));
  }
  for (int d = 0; d < dimensions; ++d) findMeaning(d);
  for (int d = 0; d < dimensions; ++d) findCentres(d);
}

int NetcdfFile::dimensionNamed(const std::string& name) const {
  const auto found = std::find_if(dimensions_.begin(), dimensions_.end(),
                                  [&](const Dimension& d) { return d.name == name; });
  return found == dimensions_.end() ? -1 : static_cast<int>(found - dimensions_.begin());
}

int NetcdfFile::variableNamed(const std::string& name) const {
  const auto found = std::find_if(variables_.begin(), variables_.end(),
                                  [&](const Variable& v) { return v.name == name; });
  return found == variables_.end() ? -1 : static_cast<int>(found - variables_.begin());
}

bool NetcdfFile::isPositions(int variable) const {
  return std::any_of(dimensions_.begin(), dimensions_.end(),
                     [&](const Dimension& d) { return d.variable == variable; });
}

std::vector<int> NetcdfFile::spaceOf(int v) const {
  std::vector<int> space = variable(v).dimensions;
  std::erase_if(space, [&](int d) { return dimension(d).is == Is::kTime; });
  return space;
}

std::string NetcdfFile::text(int variable, const char* name) const {
  return textIn(id_, variable, name);
}

std::string NetcdfFile::groupText(const char* group, const char* name) const {
  int id = -1;
  return nc_inq_grp_ncid(id_, group, &id) == NC_NOERR ? textIn(id, NC_GLOBAL, name) : "";
}

std::vector<double> NetcdfFile::numbers(int variable, const char* name) const {
  nc_type type = NC_NAT;
  std::size_t length = 0;
  constexpr std::size_t kMost = 1000;
  if (nc_inq_att(id_, variable, name, &type, &length) != NC_NOERR || type == NC_CHAR ||
      type > NC_UINT64 || length > kMost) {
    return {};
  }
  std::vector<double> out(length);
  check(nc_get_att_double(id_, variable, name, out.data()));
  return out;
}

void NetcdfFile::read(int variable, const std::vector<std::size_t>& start,
                      const std::vector<std::size_t>& count, double* to) const {
  check(nc_get_vara_double(id_, variable, start.data(), count.data(), to));
}

std::vector<double> NetcdfFile::positions(int d) const {
  const Dimension& dimension = dimensions_[static_cast<std::size_t>(d)];
  checkAbsurd(static_cast<double>(dimension.length));
  std::vector<double> out(dimension.length);
  if (dimension.variable >= 0) {
    read(dimension.variable, {0}, {dimension.length}, out.data());
  } else {
    for (std::size_t i = 0; i < out.size(); ++i) out[i] = static_cast<double>(i);
  }
  return out;
}

void NetcdfFile::checkAbsurd(double values) const {
  std::error_code error;
  const auto there = static_cast<double>(std::filesystem::file_size(path_, error));
  if (leastDeflated(values) > there) {
    refuse(fmt::format("the header states {:.3g} values, more than the file can hold", values));
  }
  if (values > kMostVoxels) {
    throw VolumeError(path_.string(),
                      fmt::format("a variable has {:.3g} values, more than the limit of {:.0g}",
                                  values, kMostVoxels),
                      "export fewer time steps, or a smaller part");
  }
}

void NetcdfFile::check(int status) const {
  if (status == NC_NOERR) return;
  refuse(fmt::format("the netCDF library cannot read the file ({})", nc_strerror(status)));
}

void NetcdfFile::refuse(const std::string& why) const {
  throw VolumeError(path_.string(), why,
                    "the file may be truncated or damaged: copy or export it again");
}

/// Finds the axis of a dimension by its variable's axis, units and names, and its own name.
void NetcdfFile::findMeaning(int d) {
  Dimension& dimension = dimensions_[static_cast<std::size_t>(d)];
  for (std::size_t v = 0; v < variables_.size(); ++v) {
    const Variable& variable = variables_[v];
    if (variable.name == dimension.name && variable.dimensions == std::vector{d} &&
        variable.type != NC_CHAR && variable.type <= NC_UINT64) {
      dimension.variable = static_cast<int>(v);
    }
  }
  std::string name = dimension.name;
  for (char& c : name) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  const auto named = [&](std::initializer_list<const char*> names) {
    return std::find(names.begin(), names.end(), name) != names.end();
  };
  // Members of an ensemble and forecast steps are not dimensions of space.
  const std::string standard =
      dimension.variable < 0 ? "" : text(dimension.variable, "standard_name");
  if (standard == "realization" || standard == "forecast_period" ||
      named({"number", "member", "ensemble", "realization", "step", "forecast_period"})) {
    dimension.is = Is::kNoSpace;
    return;
  }
  if (dimension.variable >= 0) {
    const std::string axis = text(dimension.variable, "axis");
    const std::string unit = text(dimension.variable, "units");
    if (axis == "X" || hasPart(unit, "degrees_e") || hasPart(unit, "degree_e")) {
      dimension.is = Is::kX;
    } else if (axis == "Y" || hasPart(unit, "degrees_n") || hasPart(unit, "degree_n")) {
      dimension.is = Is::kY;
    } else if (axis == "T" || hasPart(unit, " since ")) {
      dimension.is = Is::kTime;
    } else if (axis == "Z" || hectopascals(unit) > 0.0 ||
               !text(dimension.variable, "positive").empty()) {
      dimension.is = Is::kZ;
    }
    if (dimension.is != Is::kUnknown) return;
  }
  if (named({"x", "lon", "longitude", "west_east"})) dimension.is = Is::kX;
  if (named({"y", "lat", "latitude", "south_north"})) dimension.is = Is::kY;
  if (named({"z", "lev", "level", "plev", "height", "altitude", "depth", "bottom_top"})) {
    dimension.is = Is::kZ;
  }
  if (named({"t", "time"})) dimension.is = Is::kTime;
  if (dimension.is != Is::kTime || dimension.variable >= 0) return;
  for (std::size_t v = 0; v < variables_.size(); ++v) {
    if (variables_[v].dimensions == std::vector{d} && variables_[v].type != NC_CHAR &&
        hasPart(text(static_cast<int>(v), "units"), " since ")) {
      dimension.variable = static_cast<int>(v);
      return;
    }
  }
}

/// Finds the centres of a dimension of faces: in WRF, "west_east" for "west_east_stag".
void NetcdfFile::findCentres(int d) {
  constexpr std::string_view kFaces = "_stag";
  Dimension& dimension = dimensions_[static_cast<std::size_t>(d)];
  if (!dimension.name.ends_with(kFaces)) return;
  const int centres =
      dimensionNamed(dimension.name.substr(0, dimension.name.size() - kFaces.size()));
  if (centres < 0) return;
  const Dimension& cells = dimensions_[static_cast<std::size_t>(centres)];
  if (cells.length + 1 != dimension.length) return;
  dimension.centres = centres;
  dimension.is = cells.is;
}

}  // namespace palpate::importer
