#include "palpate/scenes/apps/import/slice_spacing.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <optional>
#include <string_view>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/length_units.h"

namespace palpate::importer {
namespace {

/// A unit that scenes know, and the length of another unit in it.
struct StatedUnit {
  const char* unit = "";
  double length = 1.0;
};

/// Returns the unit of a word. Small units become um, and inches mm. Returns no value for other
/// words.
std::optional<StatedUnit> unitOf(std::string_view word) {
  const LengthUnit* stated = lengthUnitOf(word);
  if (stated == nullptr) return std::nullopt;
  if (isSceneUnit(*stated)) return StatedUnit{stated->unit};
  const LengthUnit& known = *lengthUnitOf(stated->metres < 1e-6 ? "um" : "mm");
  return StatedUnit{known.unit, stated->metres / known.metres};
}

/// Returns a positive number; 0 if the text is not one.
double positive(std::string_view text) {
  double value = 0.0;
  const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
  const bool is_number = parsed.ec == std::errc() && parsed.ptr == text.data() + text.size();
  return is_number && std::isfinite(value) && value > 0.0 ? value : 0.0;
}

double inverse(double resolution) {
  return std::isfinite(resolution) && resolution > 0.0 ? 1.0 / resolution : 0.0;
}

/// Returns the value of a line "key=value".
std::string_view valueOf(std::string_view text, std::string_view key) {
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    std::string_view line = text.substr(0, end);
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    if (line.size() > key.size() && line[key.size()] == '=' && line.substr(0, key.size()) == key) {
      return line.substr(key.size() + 1);
    }
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return {};
}

/// Returns the value of an attribute in a tag of XML.
std::string_view attributeOf(std::string_view tag, const std::string& name) {
  for (const char* quote : {"\"", "'"}) {
    for (const char* space : {" ", "\n", "\t", "\r"}) {
      const std::string begin = space + name + "=" + quote;
      const std::size_t at = tag.find(begin);
      if (at == std::string_view::npos) continue;
      tag.remove_prefix(at + begin.size());
      const std::size_t end = tag.find(quote[0]);
      return end == std::string_view::npos ? std::string_view() : tag.substr(0, end);
    }
  }
  return {};
}

void readImageJ(const TiffTags& tags, StatedStack& out) {
  out.pictures = positive(valueOf(tags.description, "images"));
  out.channels = positive(valueOf(tags.description, "channels"));
  out.times = positive(valueOf(tags.description, "frames"));
  const std::string_view written = valueOf(tags.description, "unit");
  std::optional<StatedUnit> unit = unitOf(written);
  for (const char* key : {"yunit", "zunit"}) {
    const std::string_view other = valueOf(tags.description, key);
    if (!other.empty() && other != written) unit.reset();
  }
  if (!unit) return;
  const std::string_view distance = valueOf(tags.description, "spacing");
  double z = positive(distance);
  if (distance.empty() && out.pictures > 1.0) z = 1.0;
  out.spacing.edges =
      unit->length * Vec3(inverse(tags.x_resolution), inverse(tags.y_resolution), z);
  out.spacing.unit = unit->unit;
  out.source = "ImageJ's description";
}

void readOme(std::string_view text, StatedStack& out) {
  const std::size_t at = text.find("<Pixels");
  if (at == std::string_view::npos) return;
  const std::string_view tag = text.substr(at, text.find('>', at) - at);
  out.channels = positive(attributeOf(tag, "SizeC"));
  out.times = positive(attributeOf(tag, "SizeT"));
  out.pictures = positive(attributeOf(tag, "SizeZ")) * out.channels * out.times;
  out.source = "OME-XML";
  for (int axis = 0; axis < 3; ++axis) {
    const std::string name = std::string("PhysicalSize") + "XYZ"[axis];
    const double size = positive(attributeOf(tag, name));
    if (size == 0.0) continue;
    const std::string_view written = attributeOf(tag, name + "Unit");
    const std::optional<StatedUnit> unit =
        unitOf(written.empty() ? "um" : written);  // the default of OME
    const bool fits = unit && (out.spacing.unit.empty() || out.spacing.unit == unit->unit);
    if (!fits) {
      out.spacing = {};
      return;
    }
    out.spacing.edges[axis] = unit->length * size;
    out.spacing.unit = unit->unit;
  }
}

void readResolution(const TiffTags& tags, StatedStack& out) {
  if (tags.resolution_unit != 2 && tags.resolution_unit != 3) return;
  const double unit = tags.resolution_unit == 2 ? 25.4 : 10.0;  // [mm]
  out.spacing.edges = unit * Vec3(inverse(tags.x_resolution), inverse(tags.y_resolution), 0.0);
  if (out.spacing.edges.isZero(0.0)) return;
  out.spacing.unit = "mm";
  out.source = "the resolution of the TIFF";
  out.from_resolution = true;
}

}  // namespace

Spacing spacingOf(const std::string& text) {
  const std::size_t letter = text.find_first_not_of("0123456789.,eE+-");
  const std::string_view lengths = std::string_view(text).substr(0, letter);
  const std::string_view suffix = std::string_view(text).substr(std::min(letter, text.size()));
  const std::optional<StatedUnit> unit = suffix.empty() ? StatedUnit{} : unitOf(suffix);
  Spacing out;
  std::size_t at = 0;
  bool is_valid = unit.has_value();
  for (int axis = 0; axis < 3; ++axis) {
    const std::size_t end = axis < 2 ? lengths.find(',', at) : lengths.size();
    if (end == std::string_view::npos || at > end) {
      is_valid = false;
      break;
    }
    out.edges[axis] = positive(lengths.substr(at, end - at));
    is_valid = is_valid && out.edges[axis] > 0.0;
    at = end + 1;
  }
  if (!is_valid) {
    throw Error("--spacing", fmt::format("\"{}\" is not three positive lengths and a unit", text),
                "write the edges of a voxel along x, y and z with m, cm, mm, um or nm, as in "
                "10,10,20um");
  }
  out.edges *= unit->length;
  out.unit = unit->unit;
  return out;
}

StatedStack statedBy(const TiffTags& tags) {
  StatedStack out;
  if (tags.description.rfind("ImageJ=", 0) == 0) {
    readImageJ(tags, out);
  } else if (tags.description.find("<OME") != std::string::npos) {
    readOme(tags.description, out);
  }
  if (out.spacing.unit.empty()) readResolution(tags, out);
  return out;
}

}  // namespace palpate::importer
