/// Reads netCDF files with CF conventions, which models of weather and ocean write.
#include "palpate/scenes/apps/import/read_netcdf.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <netcdf.h>
#include <optional>
#include <string_view>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/fill_values.h"
#include "palpate/scenes/apps/import/geography.h"
#include "palpate/scenes/apps/import/netcdf_file.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/shared.h"
#include "palpate/scenes/apps/import/wrf_grid.h"

namespace palpate::importer {
namespace {

bool contains(const std::string& text, std::string_view what) {
  return text.find(what) != std::string::npos;
}

/// Returns true for units such as degrees_north and degreeE, but not for plain degrees.
bool isOfEarth(std::string unit) {
  for (char& c : unit) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return contains(unit, "degree_n") || contains(unit, "degrees_n") || contains(unit, "degreen") ||
         contains(unit, "degreesn") || contains(unit, "degree_e") || contains(unit, "degrees_e") ||
         contains(unit, "degreee") || contains(unit, "degreese");
}

struct Field {
  int variable = 0;
  std::array<std::size_t, 3> axes{};  ///< Indices of the field's dimensions that are x, y and z.
  std::optional<std::size_t> time;
};

class Unpacking {
 public:
  Unpacking(const NetcdfFile& file, int v) : type_(file.variable(v).type) {
    const auto first = [&](const char* name, double otherwise) {
      const std::vector<double> numbers = file.numbers(v, name);
      return numbers.empty() ? otherwise : numbers.front();
    };
    scale_ = first("scale_factor", 1.0);
    offset_ = first("add_offset", 0.0);
    missing_ = file.numbers(v, "missing_value");
    missing_.push_back(first("_FillValue", fillOf(type_)));
    low_ = first("valid_min", -std::numeric_limits<double>::infinity());
    high_ = first("valid_max", std::numeric_limits<double>::infinity());
    if (const auto range = file.numbers(v, "valid_range"); range.size() == 2) {
      low_ = range[0];
      high_ = range[1];
    }
    // An attribute may have more digits than a float, so it is rounded like the variable's values.
    if (type_ == NC_FLOAT) {
      for (double& value : missing_) value = static_cast<double>(static_cast<float>(value));
    }
    // Classic netCDF has no unsigned types, so an attribute states that values are unsigned.
    const bool is_unsigned = file.text(v, "_Unsigned") == "true";
    const double bits = !is_unsigned        ? 0.0
                        : type_ == NC_BYTE  ? 8.0
                        : type_ == NC_SHORT ? 16.0
                        : type_ == NC_INT   ? 32.0
                                            : 0.0;
    turn_ = bits > 0.0 ? std::exp2(bits) : 0.0;
    for (double* bound : {&low_, &high_}) {
      if (*bound < 0.0 && std::isfinite(*bound)) *bound += turn_;
    }
  }

  /// Returns true if the values become floats, not doubles: packed values, floats, and integers of
  /// 1 or 2 bytes.
  [[nodiscard]] bool fitsFloat() const {
    return isPacked() || type_ == NC_FLOAT || type_ == NC_BYTE || type_ == NC_UBYTE ||
           type_ == NC_SHORT || type_ == NC_USHORT;
  }

  /// Returns true if the values are the stored numbers, and these are whole.
  [[nodiscard]] bool keepsWholeNumbers() const {
    return !isPacked() && type_ != NC_FLOAT && type_ != NC_DOUBLE;
  }

  /// Returns the value of a stored number; NaN if the number marks missing data.
  [[nodiscard]] double operator()(double stored) const {
    const bool none = std::find(missing_.begin(), missing_.end(), stored) != missing_.end();
    const double value = stored < 0.0 ? stored + turn_ : stored;
    if (none || value < low_ || value > high_) return std::numeric_limits<double>::quiet_NaN();
    return isPacked() ? scale_ * value + offset_ : value;
  }

 private:
  [[nodiscard]] bool isPacked() const { return scale_ != 1.0 || offset_ != 0.0; }

  /// Returns the library's fill value for a type. Returns NaN for types of one byte, which have
  /// none, and for integers of 8 bytes.
  static double fillOf(nc_type type) {
    switch (type) {
      case NC_SHORT:
        return NC_FILL_SHORT;
      case NC_USHORT:
        return NC_FILL_USHORT;
      case NC_INT:
        return NC_FILL_INT;
      case NC_UINT:
        return NC_FILL_UINT;
      case NC_FLOAT:
        return static_cast<double>(NC_FILL_FLOAT);
      case NC_DOUBLE:
        return NC_FILL_DOUBLE;
      default:
        return std::numeric_limits<double>::quiet_NaN();
    }
  }

  nc_type type_ = NC_NAT;
  double scale_ = 1.0;
  double offset_ = 0.0;
  std::vector<double> missing_;
  double low_ = 0.0;  ///< Lowest valid stored number; `high_`: the highest.
  double high_ = 0.0;
  double turn_ = 0.0;  ///< Added to negative numbers if the values are unsigned.
};

/// Averages values on faces of cells to the centres. `faces` is 1 for axes with faces.
Values averagedToCentres(const Values& values, const std::array<std::size_t, 3>& size,
                         const std::array<std::size_t, 3>& faces) {
  if (faces == std::array<std::size_t, 3>{}) return values;
  const std::array<std::size_t, 3> n{size[0] - faces[0], size[1] - faces[1], size[2] - faces[2]};
  Values out(values.type(), 1, n[0] * n[1] * n[2]);
  visit(values, [&](const auto* from) {
    using T = std::remove_cv_t<std::remove_pointer_t<decltype(from)>>;
    T* to = out.as<T>();
    for (std::size_t k = 0; k < n[2]; ++k) {
      for (std::size_t j = 0; j < n[1]; ++j) {
        for (std::size_t i = 0; i < n[0]; ++i) {
          double sum = 0.0;
          for (std::size_t corner = 0; corner < 8; ++corner) {
            const std::size_t x = i + (corner & 1U) * faces[0];
            const std::size_t y = j + ((corner >> 1U) & 1U) * faces[1];
            const std::size_t z = k + (corner >> 2U) * faces[2];
            sum += static_cast<double>(from[(z * size[1] + y) * size[0] + x]);
          }
          *to++ = static_cast<T>(0.125 * sum);
        }
      }
    }
  });
  return out;
}

class NetcdfReader final : public Reader {
 public:
  explicit NetcdfReader(const Request& request)
      : request_(request), file_(request.file), wrf_(wrfGridOf(file_)) {
    for (std::size_t v = 0; v < file_.variables().size(); ++v) find(static_cast<int>(v));
    if (!flat_.empty()) {
      left_.push_back(
          fmt::format("{}: skipped: fewer than three dimensions of space have two or more points",
                      fmt::join(flat_, ", ")));
    }
    if (fields_.empty()) {
      if (const std::string type = file_.groupText("VTKHDF", "Type"); !type.empty()) {
        throw VolumeError(request.file.string(),
                          fmt::format("the file is {} in VTK's HDF5 format; palpate imports "
                                      "only images and unstructured grids in this format",
                                      type),
                          "export a volume as .vti or .vtu, for example with ParaView");
      }
      throw VolumeError(request.file.string(),
                        left_.empty()
                            ? "no variable of the netCDF file is a volume"
                            : "no variable of the netCDF file is a volume: " + left_.front(),
                        "export variables over x, y and z, or longitude, latitude and level");
    }
    const Field& first = fields_.front();
    if (first.time) {
      time_ = file_.variables()[static_cast<std::size_t>(first.variable)].dimensions[*first.time];
      times_ = file_.positions(time_);
      if (times_.size() == 1) times_.clear();
    }
  }

  std::vector<double> times() const override { return times_; }
  std::optional<double> timeUnit() const override {
    const int variable = time_ < 0 ? -1 : file_.dimension(time_).variable;
    return variable < 0 ? std::nullopt : secondsIn(file_.text(variable, "units"));
  }

  Content read(std::size_t step) override {
    Content content;
    content.description = file_.text(NC_GLOBAL, "title");
    content.notes = left_;
    const bool asked = std::any_of(fields_.begin(), fields_.end(),
                                   [&](const Field& field) { return isAsked(nameOf(field)); });
    Grids grids;
    for (const Field& field : fields_) {
      if (asked && !isAsked(nameOf(field))) continue;
      const std::vector<int>& own = dimensionsOf(field);
      if (field.time && times_.size() > 1 && own[*field.time] != time_) {
        content.notes.push_back(fmt::format("{}: skipped: its times differ from those of {}",
                                            nameOf(field), nameOf(fields_.front())));
        continue;
      }
      std::vector<int> axes;
      for (const std::size_t a : field.axes) axes.push_back(file_.centresOf(own[a]));
      grids[axes].push_back(&field);
    }
    noteWrf(grids, content.notes);
    double done = 0.0;
    for (const auto& [axes, fields] : grids) {
      EarthGrid grid;
      for (std::size_t a = 0; a < 3; ++a) grid.axes[a] = axisOf(axes[a], a);
      const int across = file_.dimension(axes[0]).variable;
      grid.projected = isWrf(axes) || (across >= 0 && file_.text(across, "standard_name") ==
                                                          "projection_x_coordinate");
      for (const Field* field : fields) {
        Array array;
        array.name = nameOf(*field);
        array.unit = file_.text(field->variable, "units");
        readValues(*field, step, array, content.notes);
        grid.arrays.push_back(std::move(array));
        grid.standard.push_back(file_.text(field->variable, "standard_name"));
        if (request_.progress) request_.progress(++done / static_cast<double>(fields_.size()));
      }
      for (Piece& piece :
           earthPieces(std::move(grid), request_.fields, request_.file.string(), content)) {
        content.pieces.push_back(std::move(piece));
      }
    }
    return content;
  }

 private:
  [[nodiscard]] bool isAsked(const std::string& name) const {
    return std::find(request_.fields.begin(), request_.fields.end(), name) != request_.fields.end();
  }
  [[nodiscard]] const std::string& nameOf(const Field& field) const {
    return file_.variables()[static_cast<std::size_t>(field.variable)].name;
  }
  [[nodiscard]] const std::vector<int>& dimensionsOf(const Field& field) const {
    return file_.variables()[static_cast<std::size_t>(field.variable)].dimensions;
  }

  using Grids = std::map<std::vector<int>, std::vector<const Field*>>;

  [[nodiscard]] bool isWrf(const std::vector<int>& axes) const {
    return wrf_ && axes[0] == wrf_->x && axes[1] == wrf_->y;
  }

  void noteWrf(const Grids& grids, std::vector<std::string>& notes) const {
    std::vector<std::string> averaged;
    bool any = false;
    for (const auto& [axes, fields] : grids) {
      any = any || isWrf(axes);
      for (const Field* field : fields) {
        if (isOnFaces(*field)) averaged.push_back(nameOf(*field));
      }
    }
    if (any) notes.insert(notes.end(), wrf_->notes.begin(), wrf_->notes.end());
    if (averaged.empty()) return;
    notes.push_back(fmt::format("{}: averaged from the cells' faces to the cells' centres",
                                fmt::join(averaged, ", ")));
  }
  [[nodiscard]] bool isOnFaces(const Field& field) const {
    const std::vector<int>& own = dimensionsOf(field);
    return std::any_of(field.axes.begin(), field.axes.end(),
                       [&](std::size_t a) { return file_.dimension(own[a]).centres >= 0; });
  }

  /// Returns true if another variable has a longitude or latitude for each point of the field's
  /// levels.
  [[nodiscard]] bool isCurved(int v, const Field& field) const {
    const std::vector<int>& own = dimensionsOf(field);
    const std::array plane{file_.centresOf(own[field.axes[0]]),
                           file_.centresOf(own[field.axes[1]])};
    const bool straight = std::all_of(plane.begin(), plane.end(),
                                      [&](int d) { return file_.dimension(d).variable >= 0; });
    const std::string named = " " + file_.text(v, "coordinates") + " ";
    for (std::size_t o = 0; o < file_.variables().size(); ++o) {
      const int other = static_cast<int>(o);
      std::vector<int> space = file_.spaceOf(other);
      if (space.size() != 2) continue;
      for (int& d : space) d = file_.centresOf(d);
      const std::string unit = file_.text(other, "units");
      if (contains(unit, "degree") && contains(named, " " + file_.variable(other).name + " ")) {
        return true;
      }
      if (!straight && isOfEarth(unit) &&
          std::is_permutation(space.begin(), space.end(), plane.begin())) {
        return true;
      }
    }
    return false;
  }

  void find(int v) {
    const Variable& variable = file_.variables()[static_cast<std::size_t>(v)];
    if (variable.dimensions.size() < 3 || variable.type == NC_CHAR || variable.type > NC_UINT64 ||
        file_.isPositions(v) || variable.name.ends_with("_bnds") ||
        variable.name.ends_with("_bounds")) {
      return;
    }
    const auto leave = [&](const std::string& why) {
      left_.push_back(fmt::format("{}: skipped: {}", variable.name, why));
    };
    Field field;
    field.variable = v;
    std::array<std::optional<std::size_t>, 3> axes;
    std::vector<std::size_t> unknown;
    std::vector<std::size_t> others;
    for (std::size_t i = 0; i < variable.dimensions.size(); ++i) {
      const Dimension& dimension = file_.dimension(variable.dimensions[i]);
      if (dimension.is == Is::kTime) {
        if (!field.time) field.time = i;
        continue;
      }
      if (dimension.length < 2) continue;
      if (dimension.is == Is::kNoSpace) {
        others.push_back(i);
        continue;
      }
      const auto slot = static_cast<std::size_t>(dimension.is) - 1;
      if (dimension.is != Is::kUnknown && !axes[slot]) {
        axes[slot] = i;
      } else {
        unknown.push_back(i);
      }
    }
    // Unknown dimensions become x, y and z, beginning with the last dimension, the fastest.
    for (std::optional<std::size_t>& axis : axes) {
      if (axis || unknown.empty()) continue;
      axis = unknown.back();
      unknown.pop_back();
    }
    if (!axes[0] || !axes[1] || !axes[2]) {
      if (!(isOfEarth(file_.text(v, "units")) && file_.spaceOf(v).size() == 2)) {
        flat_.push_back(variable.name);
      }
      return;
    }
    for (std::size_t a = 0; a < 3; ++a) field.axes[a] = *axes[a];
    const std::vector<int> rows{file_.centresOf(variable.dimensions[field.axes[0]]),
                                file_.centresOf(variable.dimensions[field.axes[1]])};
    if (!isWrf(rows) && isCurved(v, field)) {
      return leave(
          "longitude and latitude each depend on two dimensions: interpolate the variable to a "
          "regular grid, for example with cdo remapbil");
    }
    const Dimension& levels = file_.dimension(variable.dimensions[field.axes[2]]);
    if (isWrf(rows) && wrf_->z >= 0 && levels.variable < 0 && !isAsked(variable.name) &&
        file_.centresOf(variable.dimensions[field.axes[2]]) != wrf_->z) {
      return leave(fmt::format(
          "its levels ({}) have no height; to import it alone with an assumed spacing, add --field "
          "{}",
          levels.name, variable.name));
    }
    others.insert(others.end(), unknown.begin(), unknown.end());
    for (const std::size_t i : others) {
      const Dimension& dimension = file_.dimension(variable.dimensions[i]);
      left_.push_back(fmt::format("{}: only the first of {} entries along {} is imported",
                                  variable.name, dimension.length, dimension.name));
    }
    double values = 1.0;
    for (const int d : variable.dimensions) {
      values *= static_cast<double>(file_.dimension(d).length);
    }
    file_.checkAbsurd(values);
    fields_.push_back(field);
  }

  [[nodiscard]] Axis axisOf(int d, std::size_t a) const {
    Axis axis;
    if (wrf_ && (d == wrf_->x || d == wrf_->y)) {
      axis.unit = "m";
      for (std::size_t i = 0; i < file_.dimension(d).length; ++i) {
        axis.at.push_back(static_cast<double>(i) * (d == wrf_->x ? wrf_->dx : wrf_->dy));
      }
      return axis;
    }
    if (wrf_ && d == wrf_->z && !wrf_->heights.empty()) {
      axis.unit = "m";
      axis.at = wrf_->heights;
      return axis;
    }
    axis.at = file_.positions(d);
    const int variable = file_.dimension(d).variable;
    if (variable < 0) {
      axis.along = a == 2 ? Along::kNumber : Along::kOther;
      return axis;
    }
    axis.unit = file_.text(variable, "units");
    if (a == 0 && axis.unit.starts_with("degree")) {
      axis.along = Along::kLongitude;
    } else if (a == 1 && axis.unit.starts_with("degree")) {
      axis.along = Along::kLatitude;
    } else if (a == 2 && hectopascals(axis.unit) > 0.0) {
      axis.along = Along::kPressure;
      for (double& p : axis.at) {
        p *= hectopascals(axis.unit);
        if (!(p > 0.0)) {
          throw VolumeError(request_.file.string(),
                            fmt::format("a pressure of {:.6g} hPa along {} is not above 0", p,
                                        file_.dimension(d).name),
                            "correct the coordinates");
        }
      }
    } else if (a == 2 && file_.text(variable, "positive") == "down") {
      axis.along = Along::kDepth;
    } else if (a == 2 && (axis.unit.empty() || axis.unit == "1" || axis.unit == "level")) {
      axis.along = Along::kNumber;
    }
    return axis;
  }

  /// Reads one step of a field, x fastest. Unpacks packed values, sets missing values to NaN, and
  /// averages values on faces of cells to the centres.
  void readValues(const Field& field, std::size_t step, Array& array,
                  std::vector<std::string>& notes) const {
    const std::vector<int>& own = dimensionsOf(field);
    std::array<std::size_t, 3> size{};
    std::array<std::size_t, 3> faces{};
    for (std::size_t a = 0; a < 3; ++a) {
      size[a] = file_.dimension(own[field.axes[a]]).length;
      faces[a] = file_.dimension(own[field.axes[a]]).centres >= 0 ? 1 : 0;
    }
    const Unpacking unpack(file_, field.variable);
    Values out(unpack.fitsFloat() ? Type::kFloat32 : Type::kFloat64, 1,
               size[0] * size[1] * size[2]);
    std::vector<double> plane(size[0] * size[1]);
    const bool x_last = field.axes[0] > field.axes[1];
    std::vector<std::size_t> start(own.size(), 0);
    std::vector<std::size_t> count(own.size(), 1);
    if (field.time) start[*field.time] = step;
    count[field.axes[0]] = size[0];
    count[field.axes[1]] = size[1];
    visit(out, [&](auto* given) {
      using T = std::remove_pointer_t<decltype(given)>;
      T* to = given;
      for (std::size_t k = 0; k < size[2]; ++k) {
        start[field.axes[2]] = k;
        file_.read(field.variable, start, count, plane.data());
        for (std::size_t j = 0; j < size[1]; ++j) {
          for (std::size_t i = 0; i < size[0]; ++i) {
            *to++ = static_cast<T>(unpack(plane[x_last ? j * size[0] + i : i * size[1] + j]));
          }
        }
      }
    });
    array.values = std::move(out);
    array.whole = unpack.keepsWholeNumbers();
    SingleProcess alone;
    hideFillValues(array, notes, Shared(alone));
    array.values = averagedToCentres(array.values, size, faces);
  }

  Request request_;
  NetcdfFile file_;
  std::optional<WrfGrid> wrf_;
  std::vector<Field> fields_;
  std::vector<std::string> left_;
  /// Variables with fewer than three dimensions of space that have two or more points.
  std::vector<std::string> flat_;
  int time_ = -1;
  std::vector<double> times_;
};

}  // namespace

std::unique_ptr<Reader> openCf(const Request& request) {
  return std::make_unique<NetcdfReader>(request);
}

}  // namespace palpate::importer
