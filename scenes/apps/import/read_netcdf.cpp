/// Reads netCDF files with CF conventions, which weather and ocean models write.
#include "palpate/scenes/apps/import/read_netcdf.h"

#include <algorithm>
#include <array>
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
#include "palpate/scenes/apps/import/geography.h"
#include "palpate/scenes/apps/import/grids.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {
namespace {

/// Meaning of a dimension.
enum class Is : std::uint8_t { kUnknown, kX, kY, kZ, kTime, kNoSpace };

struct Dimension {
  std::string name;
  std::size_t length = 0;
  int variable = -1;  ///< Index of the variable with its positions; -1: none.
  Is is = Is::kUnknown;
};

struct Variable {
  std::string name;
  nc_type type = NC_NAT;
  std::vector<int> dimensions;
};

bool contains(const std::string& text, std::string_view what) {
  return text.find(what) != std::string::npos;
}

/// An open file of the netCDF library.
class File {
 public:
  explicit File(const std::filesystem::path& path) : path_(path) {
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
    for (std::size_t d = 0; d < dimensions_.size(); ++d) see(static_cast<int>(d));
  }
  File(const File&) = delete;
  File& operator=(const File&) = delete;
  ~File() { nc_close(id_); }

  [[nodiscard]] const std::vector<Variable>& variables() const { return variables_; }
  [[nodiscard]] const Dimension& dimension(int d) const {
    return dimensions_[static_cast<std::size_t>(d)];
  }
  [[nodiscard]] bool isPositions(int variable) const {
    return std::any_of(dimensions_.begin(), dimensions_.end(),
                       [&](const Dimension& d) { return d.variable == variable; });
  }

  /// Returns the text of an attribute; an empty text if it is absent.
  [[nodiscard]] std::string text(int variable, const char* name) const {
    nc_type type = NC_NAT;
    std::size_t length = 0;
    if (nc_inq_att(id_, variable, name, &type, &length) != NC_NOERR) return "";
    std::string out;
    constexpr std::size_t kLongest = 4096;
    if (type == NC_CHAR && length <= kLongest) {
      out.resize(length);
      check(nc_get_att_text(id_, variable, name, out.data()));
    } else if (type == NC_STRING && length == 1) {
      char* string = nullptr;
      check(nc_get_att_string(id_, variable, name, &string));
      if (string != nullptr) out = std::string(string).substr(0, kLongest);
      nc_free_string(1, &string);
    }
    while (!out.empty() && (out.back() == '\0' || out.back() == ' ')) out.pop_back();
    return out;
  }

  /// Returns the numbers of an attribute; empty if it is absent.
  [[nodiscard]] std::vector<double> numbers(int variable, const char* name) const {
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

  /// Reads the values of a variable from the indices `start` on, `count` along each dimension.
  void read(int variable, const std::vector<std::size_t>& start,
            const std::vector<std::size_t>& count, double* to) const {
    check(nc_get_vara_double(id_, variable, start.data(), count.data(), to));
  }

  /// Returns the positions along a dimension; indices from 0 if the file has no positions.
  [[nodiscard]] std::vector<double> positions(int d) const {
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

  /// Throws VolumeError if there are more values than the file could hold at the best possible
  /// compression.
  void checkAbsurd(double values) const {
    std::error_code error;
    const auto there = static_cast<double>(std::filesystem::file_size(path_, error));
    if (values <= kMostVoxels && leastDeflated(values) <= there) return;
    refuse(fmt::format("the header states {:.3g} values, more than the file can hold", values));
  }

 private:
  void check(int status) const {
    if (status == NC_NOERR) return;
    refuse(fmt::format("the netCDF library cannot read the file ({})", nc_strerror(status)));
  }
  [[noreturn]] void refuse(const std::string& why) const {
    throw VolumeError(path_.string(), why,
                      "the file may be truncated or damaged: copy or export it again");
  }

  /// Finds the meaning of a dimension from the variable with the same name: from its axis, units,
  /// standard name and name.
  void see(int d) {
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
    // These dimensions are not in space: the members of an ensemble, and forecast steps beside a
    // time dimension.
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
      if (axis == "X" || contains(unit, "degrees_e") || contains(unit, "degree_e")) {
        dimension.is = Is::kX;
      } else if (axis == "Y" || contains(unit, "degrees_n") || contains(unit, "degree_n")) {
        dimension.is = Is::kY;
      } else if (axis == "T" || contains(unit, " since ")) {
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
  }

  std::filesystem::path path_;
  int id_ = -1;
  std::vector<Dimension> dimensions_;
  std::vector<Variable> variables_;
};

/// A variable whose dimensions are a volume, or a volume and time.
struct Field {
  int variable = 0;
  std::array<std::size_t, 3> axes{};  ///< Indices of its dimensions that are x, y and z.
  std::optional<std::size_t> time;    ///< Index of its time dimension; no value if it has none.
};

class NetcdfReader final : public Reader {
 public:
  explicit NetcdfReader(const Request& request) : request_(request), file_(request.file) {
    for (std::size_t v = 0; v < file_.variables().size(); ++v) find(static_cast<int>(v));
    if (fields_.empty()) {
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

  Content read(std::size_t step) override {
    Content content;
    content.description = file_.text(NC_GLOBAL, "title");
    content.notes = left_;
    const bool asked = std::any_of(fields_.begin(), fields_.end(),
                                   [&](const Field& field) { return isAsked(nameOf(field)); });
    // Reads all fields on the same grid together.
    std::map<std::vector<int>, std::vector<const Field*>> grids;
    for (const Field& field : fields_) {
      if (asked && !isAsked(nameOf(field))) continue;
      const std::vector<int>& own = dimensionsOf(field);
      if (field.time && times_.size() > 1 && own[*field.time] != time_) {
        content.notes.push_back(fmt::format("{}: skipped: its times differ from those of {}",
                                            nameOf(field), nameOf(fields_.front())));
        continue;
      }
      std::vector<int> axes;
      for (const std::size_t a : field.axes) axes.push_back(own[a]);
      grids[axes].push_back(&field);
    }
    double done = 0.0;
    for (const auto& [axes, fields] : grids) {
      EarthGrid grid;
      for (std::size_t a = 0; a < 3; ++a) grid.axes[a] = axisOf(axes[a], a);
      const int across = file_.dimension(axes[0]).variable;
      grid.projected =
          across >= 0 && file_.text(across, "standard_name") == "projection_x_coordinate";
      for (const Field* field : fields) {
        Array array;
        array.name = nameOf(*field);
        array.unit = file_.text(field->variable, "units");
        array.values = valuesOf(*field, step);
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

  /// Adds a variable to the fields if its dimensions are a volume.
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
    // Dimensions of unknown meaning become x, y and z from the last one on: the last dimension is
    // the fastest.
    for (std::optional<std::size_t>& axis : axes) {
      if (axis || unknown.empty()) continue;
      axis = unknown.back();
      unknown.pop_back();
    }
    if (!axes[0] || !axes[1] || !axes[2]) {
      return leave("the variable has fewer than three dimensions of space");
    }
    for (std::size_t a = 0; a < 3; ++a) field.axes[a] = *axes[a];
    // Rejects variables on curvilinear grids, whose positions depend on two dimensions.
    const std::string coordinates = file_.text(v, "coordinates");
    for (std::size_t c = 0; c < file_.variables().size(); ++c) {
      const Variable& other = file_.variables()[c];
      if (other.dimensions.size() == 2 &&
          contains(" " + coordinates + " ", " " + other.name + " ") &&
          contains(file_.text(static_cast<int>(c), "units"), "degree")) {
        return leave(
            "longitude and latitude each depend on two dimensions: interpolate the variable to a "
            "regular grid, for example with cdo remapbil");
      }
    }
    others.insert(others.end(), unknown.begin(), unknown.end());
    for (const std::size_t i : others) {
      const Dimension& dimension = file_.dimension(variable.dimensions[i]);
      left_.push_back(fmt::format("{}: only the first of {} along {} is imported", variable.name,
                                  dimension.length, dimension.name));
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
                            fmt::format("the pressure {:g} hPa is not above 0", p),
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

  /// Reads one step of a field with x fastest. Packed values are unpacked, and missing values are
  /// NaN.
  [[nodiscard]] Values valuesOf(const Field& field, std::size_t step) const {
    const std::vector<int>& own = dimensionsOf(field);
    std::array<std::size_t, 3> size{};
    for (std::size_t a = 0; a < 3; ++a) size[a] = file_.dimension(own[field.axes[a]]).length;
    const int v = field.variable;
    const auto first = [&](const char* name, double otherwise) {
      const std::vector<double> numbers = file_.numbers(v, name);
      return numbers.empty() ? otherwise : numbers.front();
    };
    const double scale = first("scale_factor", 1.0);
    const double offset = first("add_offset", 0.0);
    const bool packed = scale != 1.0 || offset != 0.0;
    const nc_type type = file_.variables()[static_cast<std::size_t>(v)].type;
    std::vector<double> missing = file_.numbers(v, "missing_value");
    missing.push_back(first("_FillValue", fillOf(type)));
    double low = first("valid_min", -std::numeric_limits<double>::infinity());
    double high = first("valid_max", std::numeric_limits<double>::infinity());
    if (const auto range = file_.numbers(v, "valid_range"); range.size() == 2) {
      low = range[0];
      high = range[1];
    }
    // The classic format has no unsigned types, so an attribute states that values are unsigned.
    const bool is_unsigned = file_.text(v, "_Unsigned") == "true";
    const double bits = !is_unsigned       ? 0.0
                        : type == NC_BYTE  ? 8.0
                        : type == NC_SHORT ? 16.0
                        : type == NC_INT   ? 32.0
                                           : 0.0;
    const double turn = bits > 0.0 ? std::exp2(bits) : 0.0;
    for (double* bound : {&low, &high}) {
      if (*bound < 0.0 && std::isfinite(*bound)) *bound += turn;
    }

    const bool fits = packed || type == NC_FLOAT || type == NC_BYTE || type == NC_UBYTE ||
                      type == NC_SHORT || type == NC_USHORT;
    Values out(fits ? Type::kFloat32 : Type::kFloat64, 1, size[0] * size[1] * size[2]);
    // Reads one plane at a time. The file decides which axis of the plane is faster.
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
        file_.read(v, start, count, plane.data());
        for (std::size_t j = 0; j < size[1]; ++j) {
          for (std::size_t i = 0; i < size[0]; ++i) {
            double value = plane[x_last ? j * size[0] + i : i * size[1] + j];
            const bool none = std::find(missing.begin(), missing.end(), value) != missing.end();
            if (value < 0.0) value += turn;
            *to++ = none || value < low || value > high
                        ? std::numeric_limits<T>::quiet_NaN()
                        : static_cast<T>(packed ? scale * value + offset : value);
          }
        }
      }
    });
    return out;
  }

  /// Returns the library's fill value, which marks values that were never written. Types of one
  /// byte have no fill value.
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

  Request request_;
  File file_;
  std::vector<Field> fields_;
  std::vector<std::string> left_;
  int time_ = -1;
  std::vector<double> times_;
};

}  // namespace

std::unique_ptr<Reader> openCf(const Request& request) {
  return std::make_unique<NetcdfReader>(request);
}

}  // namespace palpate::importer
