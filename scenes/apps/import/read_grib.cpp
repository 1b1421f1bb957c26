/// Reads GRIB files of weather services with ecCodes, and stacks the fields of levels to volumes.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <eccodes.h>
#include <limits>
#include <map>
#include <memory>
#include <set>
#include <tuple>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/geography.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {
namespace {

constexpr const char* kDamaged = "it may be truncated or damaged: copy or export it again";
/// Limit for one message: the whole earth at a step below a fortieth of a degree.
constexpr double kMostPoints = 1.2e8;

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
struct CloseMessage {
  void operator()(codes_handle* message) const { codes_handle_delete(message); }
};
using Stream = std::unique_ptr<std::FILE, CloseFile>;
using Handle = std::unique_ptr<codes_handle, CloseMessage>;

long integerOf(const Handle& message, const char* key) {
  long value = 0;
  return codes_get_long(message.get(), key, &value) == CODES_SUCCESS ? value : 0;
}
double numberOf(const Handle& message, const char* key) {
  double value = 0.0;
  return codes_get_double(message.get(), key, &value) == CODES_SUCCESS ? value : 0.0;
}
std::string textOf(const Handle& message, const char* key) {
  std::array<char, 256> text{};
  std::size_t length = text.size();
  if (codes_get_string(message.get(), key, text.data(), &length) != CODES_SUCCESS) return "";
  text.back() = '\0';
  return text.data();
}

/// Positions of a message's points, as far as its header states them.
struct Grid {
  std::string type;
  long nx = 0;
  long ny = 0;
  std::array<double, 6> at{};  ///< First and last, or the steps.

  bool operator==(const Grid&) const = default;
  bool operator<(const Grid& other) const {
    return std::tie(type, nx, ny, at) < std::tie(other.type, other.nx, other.ny, other.at);
  }
};

/// A message without its values.
struct Field {
  std::string name;
  std::string unit;
  std::string level_kind;
  double level = 0.0;
  double hours = 0.0;  ///< From the beginning of 1970.
  long member = 0;
  Grid grid;
  long offset = 0;  ///< In the file.
};

/// Converts a date such as 20261125 and a time such as 630 to hours from 1970 on.
double hoursOf(long date, long time) {
  const long year = date / 10000 - (date / 100 % 100 <= 2 ? 1 : 0);
  const long month = date / 100 % 100;
  // The algorithm is "days from civil", by Howard Hinnant.
  const long era = year / 400;
  const long of_era = year - era * 400;
  const long of_year = (153 * (month + (month > 2 ? -3 : 9)) + 2) / 5 + date % 100 - 1;
  const long days = era * 146097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719468;
  const long minutes = (days * 24 + time / 100) * 60 + time % 100;
  return static_cast<double>(minutes) / 60.0;
}

class GribReader final : public Reader {
 public:
  explicit GribReader(const Request& request)
      : request_(request), stream_(std::fopen(request.file.c_str(), "rb")) {
    if (!stream_) refuse("it cannot be read", "check its permissions");
    codes_grib_multi_support_off(codes_context_get_default());
    int status = CODES_SUCCESS;
    while (const Handle message = next(status)) scan(message);
    if (status != CODES_SUCCESS) {
      refuse(fmt::format("ecCodes cannot read it ({})", codes_get_error_message(status)), kDamaged);
    }
    if (fields_.empty()) refuse("no message is in it", kDamaged);
    std::set<double> hours;
    for (const Field& field : fields_) hours.insert(field.hours);
    if (hours.size() > 1) {
      for (const double h : hours) times_.push_back(h - *hours.begin());
    }
    first_hour_ = *hours.begin();
  }

  std::vector<double> times() const override { return times_; }

  Content read(std::size_t step) override {
    Content content;
    const double hours = first_hour_ + (step < times_.size() ? times_[step] : 0.0);
    // A volume has one quantity on one kind of levels. Volumes on one grid with the same levels are
    // read together.
    std::map<std::pair<std::string, std::string>, std::map<double, const Field*>> volumes;
    std::set<long> members;
    for (const Field& field : fields_) members.insert(field.member);
    for (const Field& field : fields_) {
      if (field.hours != hours || field.member != *members.begin()) continue;
      volumes[{field.name, field.level_kind}].emplace(field.level, &field);
    }
    if (members.size() > 1) {
      content.notes.push_back(
          fmt::format("the first of {} members of an ensemble", members.size()));
    }
    using Key = std::tuple<std::string, Grid, std::vector<double>>;
    std::map<Key, std::vector<std::map<double, const Field*>>> grids;
    for (const auto& [name, levels] : volumes) {
      const Grid& grid = levels.begin()->second->grid;
      const bool alike = std::all_of(levels.begin(), levels.end(),
                                     [&](const auto& level) { return level.second->grid == grid; });
      if (!alike || levels.size() < 2) {
        content.notes.push_back(fmt::format("{}: left out: {}", name.first,
                                            alike ? fmt::format("one level ({})", name.second)
                                                  : "its levels have grids of their own"));
        continue;
      }
      std::vector<double> heights;
      for (const auto& [level, field] : levels) heights.push_back(level);
      grids[{name.second, grid, heights}].push_back(levels);
    }
    if (grids.empty()) {
      refuse(content.notes.empty() ? "there is no volume in it"
                                   : "there is no volume in it: " + content.notes.front(),
             "give a file with several levels of a quantity");
    }
    double done = 0.0;
    for (const auto& [key, all] : grids) {
      const Grid& grid = std::get<Grid>(key);
      EarthGrid earth;
      earth.axes[2] = levelsOf(std::get<0>(key), std::get<2>(key));
      for (const auto& levels : all) {
        Array array;
        array.name = levels.begin()->second->name;
        array.unit = levels.begin()->second->unit;
        const auto plane = static_cast<std::size_t>(grid.nx) * static_cast<std::size_t>(grid.ny);
        array.values = Values(Type::kFloat32, 1, plane * levels.size());
        float* to = array.values.as<float>();
        for (const auto& [level, field] : levels) {
          readPlane(*field, to, earth);
          to += plane;
          if (request_.progress) request_.progress(++done / static_cast<double>(fields_.size()));
        }
        earth.arrays.push_back(std::move(array));
        earth.standard.emplace_back();
      }
      for (Piece& piece :
           earthPieces(std::move(earth), request_.fields, request_.file.string(), content)) {
        content.pieces.push_back(std::move(piece));
      }
    }
    return content;
  }

 private:
  [[noreturn]] void refuse(const std::string& why, const std::string& remedy) const {
    throw VolumeError(request_.file.string(), why, remedy);
  }

  /// Returns null at the end of the file.
  Handle next(int& status) const {
    return Handle(codes_handle_new_from_file(nullptr, stream_.get(), PRODUCT_GRIB, &status));
  }

  void scan(const Handle& message) {
    Field field;
    field.grid.type = textOf(message, "gridType");
    const std::string& type = field.grid.type;
    const bool globe = type == "regular_ll" || type == "rotated_ll" || type == "regular_gg";
    const bool plane = type == "lambert" || type == "polar_stereographic" || type == "mercator";
    if (!globe && !plane) {
      refuse(fmt::format("its grid is of type {}, which has no rows and columns", type),
             "interpolate it to longitudes and latitudes, as with cdo -R or grib_interpolate");
    }
    const bool is_gaussian = type == "regular_gg";
    field.grid.nx = integerOf(message, plane ? "Nx" : "Ni");
    field.grid.ny = integerOf(message, plane ? "Ny" : "Nj");
    const double points = static_cast<double>(field.grid.nx) * static_cast<double>(field.grid.ny);
    if (field.grid.nx < 2 || field.grid.ny < 2 || points > kMostPoints ||
        integerOf(message, "numberOfDataPoints") != field.grid.nx * field.grid.ny) {
      refuse(
          fmt::format("its grid of {} by {} points makes no sense", field.grid.nx, field.grid.ny),
          kDamaged);
    }
    if (plane) {
      const char* const dx = type == "mercator" ? "DiInMetres" : "DxInMetres";
      const char* const dy = type == "mercator" ? "DjInMetres" : "DyInMetres";
      field.grid.at = {numberOf(message, dx), numberOf(message, dy),
                       numberOf(message, "latitudeOfFirstGridPointInDegrees"),
                       numberOf(message, "longitudeOfFirstGridPointInDegrees")};
      if (!(field.grid.at[0] > 0.0 && field.grid.at[1] > 0.0)) {
        refuse("its grid has no spacing", kDamaged);
      }
    } else {
      field.grid.at = {numberOf(message, "longitudeOfFirstGridPointInDegrees"),
                       numberOf(message, "longitudeOfLastGridPointInDegrees"),
                       numberOf(message, "latitudeOfFirstGridPointInDegrees"),
                       numberOf(message, "latitudeOfLastGridPointInDegrees"),
                       is_gaussian ? static_cast<double>(integerOf(message, "N")) : 0.0};
    }
    field.name = textOf(message, "shortName");
    if (field.name.empty() || field.name == "unknown") {
      field.name = "param" + textOf(message, "paramId");
    }
    field.unit = unitOf(textOf(message, "units"));
    field.level_kind = textOf(message, "typeOfLevel");
    field.level = numberOf(message, "level");
    field.hours = hoursOf(integerOf(message, "validityDate"), integerOf(message, "validityTime"));
    field.member = integerOf(message, "number");
    long offset = 0;
    if (codes_get_long(message.get(), "offset", &offset) != CODES_SUCCESS) refuse("", kDamaged);
    field.offset = offset;
    fields_.push_back(std::move(field));
  }

  /// Returns "m s**-1" in the common notation.
  static std::string unitOf(std::string unit) {
    for (std::size_t at = unit.find("**"); at != std::string::npos; at = unit.find("**")) {
      unit.replace(at, 2, "^");
    }
    return unit == "~" ? "" : unit;
  }

  /// Expects levels in rising order.
  static Axis levelsOf(const std::string& kind, const std::vector<double>& levels) {
    Axis axis;
    axis.at = levels;
    axis.along = Along::kNumber;
    if (kind == "isobaricInhPa" || kind == "isobaricInPa") {
      axis.along = Along::kPressure;
      if (kind == "isobaricInPa") {
        for (double& p : axis.at) p *= 0.01;
      }
    } else if (kind == "heightAboveGround" || kind == "heightAboveSea") {
      axis.along = Along::kOther;
      axis.unit = "m";
    } else if (kind == "depthBelowSea" || kind == "depthBelowLand" ||
               kind == "depthBelowLandLayer") {
      axis.along = Along::kDepth;
      axis.unit = "m";
    }
    return axis;
  }

  /// Reads a message's values, x fastest, NaN where missing, and the positions of its points.
  void readPlane(const Field& field, float* to, EarthGrid& earth) const {
    int status = CODES_SUCCESS;
    if (std::fseek(stream_.get(), field.offset, SEEK_SET) != 0)
      refuse("it cannot be read", kDamaged);
    const Handle message = next(status);
    const auto nx = static_cast<std::size_t>(field.grid.nx);
    const auto ny = static_cast<std::size_t>(field.grid.ny);
    std::size_t count = nx * ny;
    std::vector<double> values(count);
    constexpr double kNone = -1.2345e300;
    if (message) codes_set_double(message.get(), "missingValue", kNone);
    if (!message ||
        codes_get_double_array(message.get(), "values", values.data(), &count) != CODES_SUCCESS ||
        count != values.size()) {
      refuse(fmt::format("ecCodes cannot read the values of {} at level {:g}", field.name,
                         field.level),
             kDamaged);
    }
    const bool y_first = integerOf(message, "jPointsAreConsecutive") != 0;
    const bool boustrophedon = integerOf(message, "alternativeRowScanning") != 0;
    const std::size_t row = y_first ? ny : nx;
    for (std::size_t n = 0; n < count; ++n) {
      const std::size_t line = n / row;
      std::size_t at = n % row;
      if (boustrophedon && line % 2 == 1) at = row - 1 - at;
      const double value = values[n];
      to[y_first ? at * nx + line : line * nx + at] =
          value == kNone ? std::numeric_limits<float>::quiet_NaN() : static_cast<float>(value);
    }
    if (earth.axes[0].at.empty()) placeAxes(field, message, earth);
  }

  void placeAxes(const Field& field, const Handle& message, EarthGrid& earth) const {
    const bool to_west = integerOf(message, "iScansNegatively") != 0;
    const bool to_north = integerOf(message, "jScansPositively") != 0;
    const auto even = [](long count, double first, double step) {
      std::vector<double> at;
      for (long i = 0; i < count; ++i) at.push_back(first + step * static_cast<double>(i));
      return at;
    };
    const Grid& grid = field.grid;
    Axis& x = earth.axes[0];
    Axis& y = earth.axes[1];
    if (grid.type == "lambert" || grid.type == "polar_stereographic" || grid.type == "mercator") {
      earth.projected = true;
      x.unit = y.unit = "m";
      x.at = even(grid.nx, 0.0, to_west ? -grid.at[0] : grid.at[0]);
      y.at = even(grid.ny, 0.0, to_north ? grid.at[1] : -grid.at[1]);
      return;
    }
    x.along = Along::kLongitude;
    y.along = Along::kLatitude;
    double last = grid.at[1];
    if (!to_west && last < grid.at[0]) last += 360.0;
    if (to_west && last > grid.at[0]) last -= 360.0;
    x.at = even(grid.nx, grid.at[0], (last - grid.at[0]) / static_cast<double>(grid.nx - 1));
    if (grid.type != "regular_gg") {
      y.at =
          even(grid.ny, grid.at[2], (grid.at[3] - grid.at[2]) / static_cast<double>(grid.ny - 1));
      return;
    }
    std::size_t count = 0;
    if (codes_get_size(message.get(), "distinctLatitudes", &count) == CODES_SUCCESS &&
        count == static_cast<std::size_t>(grid.ny)) {
      y.at.resize(count);
      if (codes_get_double_array(message.get(), "distinctLatitudes", y.at.data(), &count) ==
          CODES_SUCCESS) {
        const bool falls = y.at.front() > y.at.back();
        if (falls == to_north) std::reverse(y.at.begin(), y.at.end());
        return;
      }
    }
    refuse("its latitudes cannot be read", kDamaged);
  }

  Request request_;
  Stream stream_;
  std::vector<Field> fields_;
  std::vector<double> times_;
  double first_hour_ = 0.0;
};

}  // namespace

std::unique_ptr<Reader> openGrib(const Request& request) {
  return std::make_unique<GribReader>(request);
}

}  // namespace palpate::importer
