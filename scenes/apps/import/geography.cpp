#include "palpate/scenes/apps/import/geography.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <initializer_list>
#include <numbers>
#include <utility>

#include <fmt/format.h>
#include <vtkDoubleArray.h>
#include <vtkFloatArray.h>
#include <vtkNew.h>
#include <vtkPointData.h>
#include <vtkRectilinearGrid.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/vtk_pieces.h"

namespace palpate::importer {
namespace {

constexpr double kKmPerDegree = 6371.0 * std::numbers::pi / 180.0;

/// Converts a pressure [hPa] to a height in the standard atmosphere of ISO 2533 [km].
double standardHeight(double pressure) {
  constexpr double kGround = 1013.25;
  // [hPa]: pressure at 11 km, above which the temperature counts as constant
  constexpr double kTropopause = 226.3206;
  if (pressure > kTropopause) {
    return 44.330769 * (1.0 - std::pow(pressure / kGround, 1.0 / 5.255880));
  }
  return 11.0 + 6.341623 * std::log(kTropopause / pressure);
}

double kilometres(std::string unit) {
  for (char& c : unit) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  struct Length {
    double km;
    std::initializer_list<const char*> names;
  };
  const Length lengths[] = {
      {1.0, {"km", "kilometer", "kilometers", "kilometre", "kilometres"}},
      {1e-3, {"m", "meter", "meters", "metre", "metres"}},
      {1e-1, {"hm"}},
      {1e-4, {"dm"}},
      {1e-5, {"cm", "centimeter", "centimeters", "centimetre", "centimetres"}},
      {0.3048e-3, {"ft", "foot", "feet"}},
      // The pressure of sea water grows by one decibar per metre of depth, within about 3 %.
      {1e-3, {"dbar", "decibar", "decibars"}},
  };
  for (const Length& length : lengths) {
    if (std::find(length.names.begin(), length.names.end(), unit) != length.names.end()) {
      return length.km;
    }
  }
  return 0.0;
}

/// Returns true if two units differ only in notation: m/s, m s-1, m s**-1 and m.s^-1.
bool isSameUnit(const std::string& a, const std::string& b) {
  const auto plain = [](const std::string& unit) {
    std::string out;
    bool divided = false;
    for (const char c : unit) {
      if (c == '^' || c == '*' || c == ' ' || c == '.') continue;
      if (c == '/') {
        divided = true;
        continue;
      }
      out += c;
    }
    return divided ? out + "-1" : out;
  };
  return plain(a) == plain(b);
}

/// Adds multiples of 360 degrees so that successive longitudes differ by at most 180 degrees.
void unwrap(std::vector<double>& longitudes) {
  for (std::size_t i = 1; i < longitudes.size(); ++i) {
    const double step = std::remainder(longitudes[i] - longitudes[i - 1], 360.0);
    if (std::abs(longitudes[i] - longitudes[i - 1]) > 180.0)
      longitudes[i] = longitudes[i - 1] + step;
  }
}

void checkDegrees(const std::vector<double>& at, double most, const char* what,
                  const std::string& file) {
  for (const double degrees : at) {
    if (std::abs(degrees) <= most) continue;
    throw VolumeError(
        file,
        fmt::format("a {0} of {1:.6g} degrees is outside the range from -{2:g} to {2:g}", what,
                    degrees, most),
        "correct the coordinates");
  }
}

int directionOf(const std::vector<double>& at, const char* axis, const std::string& file) {
  const bool rises = at.size() < 2 || at[1] > at[0];
  for (std::size_t i = 0; i < at.size(); ++i) {
    const bool in_order = i == 0 || (rises ? at[i] > at[i - 1] : at[i] < at[i - 1]);
    if (in_order && std::isfinite(at[i])) continue;
    throw VolumeError(
        file,
        fmt::format("the positions along {} are not finite, or neither rise nor fall throughout",
                    axis),
        "correct the coordinates");
  }
  return rises ? 1 : -1;
}

/// Rounds up to 1, 2 or 5 times a power of ten.
double roundUp(double x) {
  const double power = std::pow(10.0, std::floor(std::log10(x)));
  for (const double digit : {1.0, 2.0, 5.0}) {
    if (digit * power >= x * (1.0 - 1e-9)) return digit * power;
  }
  return 10.0 * power;
}

double spanOf(const std::vector<double>& at) {
  return at.empty() ? 0.0 : std::abs(at.back() - at.front());
}

class Layout {
 public:
  Layout(EarthGrid& grid, const std::string& file, Content& content)
      : axes_(grid.axes), content_(content) {
    const bool is_globe = axes_[0].along == Along::kLongitude && axes_[1].along == Along::kLatitude;
    if (is_globe) {
      checkDegrees(axes_[0].at, 1080.0, "longitude", file);
      checkDegrees(axes_[1].at, 90.01, "latitude", file);
      layFlat();
    } else if (grid.projected) {
      scale(axes_[0]);
      scale(axes_[1]);
    }
    if (is_globe || grid.projected) {
      raise();
      content.length_unit = "km";
    } else {
      if (axes_[2].along == Along::kDepth) {
        for (double& z : axes_[2].at) z = -z;
        note("depths became negative heights");
      }
      takeUnit();
    }
  }

  [[nodiscard]] double stretch() const { return stretch_; }

 private:
  void note(std::string text) const { content_.notes.push_back(std::move(text)); }

  static void scale(Axis& axis) {
    const double km = kilometres(axis.unit);
    for (double& x : axis.at) x *= km > 0.0 ? km : 1.0;
  }

  void layFlat() {
    std::vector<double>& longitudes = axes_[0].at;
    std::vector<double>& latitudes = axes_[1].at;
    unwrap(longitudes);
    const auto [south, north] = std::minmax_element(latitudes.begin(), latitudes.end());
    const double middle = 0.5 * (*south + *north);
    const double shrunk = std::cos(middle * std::numbers::pi / 180.0);
    note(
        fmt::format("longitudes and latitudes became km on a plane: a degree is {:.4g} km to the "
                    "east, as at latitude {:.4g}, and {:.4g} km to the north",
                    shrunk * kKmPerDegree, middle, kKmPerDegree));
    for (double& x : longitudes) x *= shrunk * kKmPerDegree;
    for (double& y : latitudes) y *= kKmPerDegree;
  }

  void raise() {
    Axis& z = axes_[2];
    const double side = std::max(spanOf(axes_[0].at), spanOf(axes_[1].at));
    if (z.along == Along::kPressure) {
      for (double& at : z.at) at = standardHeight(at);
      note("pressures became heights in the standard atmosphere");
    } else if (z.along == Along::kNumber || kilometres(z.unit) == 0.0) {
      // Levels without heights get equal distances from height 0 on. Depths become negative
      // heights.
      const double step =
          side / 4.0 / static_cast<double>(std::max<std::size_t>(z.at.size(), 2) - 1);
      const double up = z.along == Along::kDepth ? -step : step;
      for (std::size_t i = 0; i < z.at.size(); ++i) z.at[i] = up * static_cast<double>(i);
      const bool is_number =
          z.along == Along::kNumber || z.unit.empty() || z.unit == "1" || z.unit == "level";
      const std::string why = is_number
                                  ? "levels have no height"
                                  : fmt::format("the unit \"{}\" of the levels is unknown", z.unit);
      note(fmt::format("{}: a spacing of {:.4g} km is assumed", why, step));
      return;
    } else if (z.along == Along::kDepth) {
      for (double& at : z.at) at = -at;
      scale(z);
      note("depths became negative heights");
    } else {
      scale(z);
    }
    const double height = spanOf(z.at);
    if (!(height > 0.0) || !(side > 0.0) || height >= side / 4.0) return;
    stretch_ = roundUp(side / 4.0 / height);
    for (double& at : z.at) at *= stretch_;
    note(fmt::format("heights are exaggerated {:g} times, so that the hand can feel them",
                     stretch_));
    content_.description +=
        fmt::format("{}heights times {:g}", content_.description.empty() ? "" : ", ", stretch_);
  }

  void takeUnit() {
    const bool same = axes_[0].unit == axes_[1].unit && axes_[0].unit == axes_[2].unit;
    const auto is_length = [](const Axis& axis) { return kilometres(axis.unit) > 0.0; };
    if (same) {
      content_.length_unit = axes_[0].unit;
    } else if (std::all_of(axes_.begin(), axes_.end(), is_length)) {
      for (Axis& axis : axes_) scale(axis);
      content_.length_unit = "km";
    }
  }

  std::array<Axis, 3>& axes_;
  Content& content_;
  double stretch_ = 1.0;
};

struct Flow {
  const char* vector;
  std::array<const char*, 3> parts;
};
constexpr std::array kFlowsByStandard{
    Flow{"wind", {"eastward_wind", "northward_wind", "upward_air_velocity"}},
    Flow{"wind", {"x_wind", "y_wind", "upward_air_velocity"}},
    Flow{"current",
         {"eastward_sea_water_velocity", "northward_sea_water_velocity",
          "upward_sea_water_velocity"}},
    Flow{"current", {"sea_water_x_velocity", "sea_water_y_velocity", "upward_sea_water_velocity"}},
};
constexpr std::array kFlowsByName{
    Flow{"wind", {"u", "v", "w"}},          Flow{"wind", {"u", "v", "wz"}},
    Flow{"wind", {"U", "V", "W"}},          Flow{"wind", {"ua", "va", "wa"}},
    Flow{"wind", {"uwnd", "vwnd", "wwnd"}}, Flow{"wind", {"UGRD", "VGRD", "DZDT"}},
    Flow{"current", {"uo", "vo", "wo"}},
};

template <class Flows>
void joinBy(const Flows& flows, const std::vector<std::string>& names, double stretch,
            const std::vector<std::string>& fields, EarthGrid& grid,
            std::vector<std::string>& notes) {
  const auto find = [&](const char* name) -> Array* {
    for (std::size_t i = 0; i < names.size(); ++i) {
      if (names[i] == name && !grid.arrays[i].values.none() &&
          grid.arrays[i].values.components() == 1) {
        return &grid.arrays[i];
      }
    }
    return nullptr;
  };
  for (const Flow& flow : flows) {
    std::array<Array*, 3> parts{find(flow.parts[0]), find(flow.parts[1]), find(flow.parts[2])};
    if (parts[0] == nullptr || parts[1] == nullptr || !isSameUnit(parts[0]->unit, parts[1]->unit))
      continue;
    if (!fields.empty() && std::find(fields.begin(), fields.end(), flow.vector) == fields.end()) {
      continue;
    }
    // The upward component often has another unit, Pa/s. Then z is 0.
    if (parts[2] != nullptr && !isSameUnit(parts[2]->unit, parts[0]->unit)) parts[2] = nullptr;
    const std::size_t count = parts[0]->values.tuples();
    Values out(Type::kFloat32, 3, count);
    for (std::size_t c = 0; c < 3; ++c) {
      const double factor = c == 2 ? stretch : 1.0;
      for (std::size_t i = 0; i < count; ++i) {
        out.as<float>()[3 * i + c] =
            parts[c] == nullptr ? 0.0F : static_cast<float>(factor * parts[c]->values.at(i, 0));
      }
    }
    if (parts[2] == nullptr) {
      notes.push_back(fmt::format("{} and {}: joined into the vector {} with z = 0", parts[0]->name,
                                  parts[1]->name, flow.vector));
    } else {
      notes.push_back(fmt::format("{}, {} and {}: joined into the vector {}{}", parts[0]->name,
                                  parts[1]->name, parts[2]->name, flow.vector,
                                  stretch > 1.0 ? ", with z exaggerated like the heights" : ""));
      parts[2]->values = Values();
    }
    parts[1]->values = Values();
    parts[0]->values = std::move(out);
    parts[0]->name = flow.vector;
  }
}

Values risen(const Values& values, const std::array<std::size_t, 3>& size,
             const std::array<int, 3>& direction) {
  if (direction == std::array{1, 1, 1}) return values;
  Values out(values.type(), 1, values.tuples());
  visit(values, [&](const auto* from) {
    using T = std::remove_cv_t<std::remove_pointer_t<decltype(from)>>;
    T* to = out.as<T>();
    const auto turned = [&](std::size_t i, std::size_t a) {
      return direction[a] < 0 ? size[a] - 1 - i : i;
    };
    for (std::size_t k = 0; k < size[2]; ++k) {
      for (std::size_t j = 0; j < size[1]; ++j) {
        const T* row = from + (turned(k, 2) * size[1] + turned(j, 1)) * size[0];
        for (std::size_t i = 0; i < size[0]; ++i) *to++ = row[turned(i, 0)];
      }
    }
  });
  return out;
}

/// Returns a VTK array that shares the memory of `array` without owning it.
vtkSmartPointer<vtkDataArray> viewOf(const Array& array) {
  const auto length = static_cast<vtkIdType>(array.values.size());
  vtkSmartPointer<vtkDataArray> out;
  if (array.values.type() == Type::kFloat32) {
    auto floats = vtkSmartPointer<vtkFloatArray>::New();
    floats->SetArray(array.values.as<float>(), length, 1);
    out = floats;
  } else {
    auto doubles = vtkSmartPointer<vtkDoubleArray>::New();
    doubles->SetArray(array.values.as<double>(), length, 1);
    out = doubles;
  }
  out->SetNumberOfComponents(array.values.components());
  out->SetName(array.name.c_str());
  return out;
}

}  // namespace

double hectopascals(const std::string& unit) {
  if (unit == "hPa" || unit == "mb" || unit == "mbar" || unit == "millibar" ||
      unit == "millibars") {
    return 1.0;
  }
  return unit == "Pa" ? 0.01 : unit == "kPa" ? 10.0 : 0.0;
}

std::vector<Piece> earthPieces(EarthGrid grid, const std::vector<std::string>& fields,
                               const std::string& file, Content& content) {
  constexpr std::array kNames{"x", "y", "z"};
  const Layout layout(grid, file, content);
  std::array<std::size_t, 3> size{};
  std::array<int, 3> direction{};
  vtkNew<vtkRectilinearGrid> points;
  std::array<vtkNew<vtkDoubleArray>, 3> places;
  for (std::size_t a = 0; a < 3; ++a) {
    std::vector<double>& at = grid.axes[a].at;
    size[a] = at.size();
    direction[a] = directionOf(at, kNames[a], file);
    if (direction[a] < 0) std::reverse(at.begin(), at.end());
    for (const double x : at) places[a]->InsertNextValue(x);
  }
  points->SetDimensions(static_cast<int>(size[0]), static_cast<int>(size[1]),
                        static_cast<int>(size[2]));
  points->SetXCoordinates(places[0]);
  points->SetYCoordinates(places[1]);
  points->SetZCoordinates(places[2]);
  for (Array& array : grid.arrays) array.values = risen(array.values, size, direction);

  joinBy(kFlowsByStandard, grid.standard, layout.stretch(), fields, grid, content.notes);
  std::vector<std::string> names;
  for (const Array& array : grid.arrays) names.push_back(array.name);
  joinBy(kFlowsByName, names, layout.stretch(), fields, grid, content.notes);
  std::erase_if(grid.arrays, [](const Array& array) { return array.values.none(); });

  for (const Array& array : grid.arrays) {
    points->GetPointData()->AddArray(viewOf(array));
    content.value_unit[array.name] = array.unit;
  }
  std::vector<Piece> pieces = piecesOf(points, file, content.notes);
  // Replaces the VTK arrays, which do not own their memory, by the arrays of `grid`, which own it.
  for (Piece& piece : pieces) {
    for (Array& array : piece.arrays) {
      for (const Array& own : grid.arrays) {
        if (own.values.data() == array.values.data()) array.values = own.values;
        if (own.name != array.name && own.name != array.given) continue;
        array.unit = own.unit;
        array.whole = own.whole;
      }
    }
  }
  return pieces;
}

}  // namespace palpate::importer
