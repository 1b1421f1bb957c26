#include "palpate/scenes/apps/import/ome_zarr.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/length_units.h"

namespace palpate::importer {
namespace {

using Json = nlohmann::json;

constexpr const char* kCorrectOme = "correct the metadata, or export the image as OME-Zarr 0.4";

std::string textAt(const Json& json, const char* key) {
  const auto found = json.is_object() ? json.find(key) : json.end();
  return found != json.end() && found->is_string() ? found->get<std::string>() : "";
}

class OmeParser {
 public:
  OmeParser(const Json& json, const std::filesystem::path& file, std::vector<std::string>& notes)
      : json_(json), file_(file), notes_(notes) {}

  OmeImage parse() {
    const Json& list = json_.at("multiscales");
    if (!list.is_array() || list.empty() || !list[0].is_object()) {
      refuse("\"multiscales\" is not a list of images", kCorrectOme);
    }
    const Json& image = list[0];
    if (list.size() > 1) {
      notes_.push_back(
          fmt::format("the first of {} images in \"multiscales\" is read", list.size()));
    }
    const std::string version = textAt(image, "version");
    if (!version.empty() && version != "0.4") {
      refuse(fmt::format("the image is OME-Zarr {}, but palpate reads version 0.4", version),
             "convert it to OME-Zarr 0.4 or NRRD, or give the folder of an array with 3 axes, "
             "which has no spacing");
    }
    out_.name = textAt(image, "name");
    parseAxes(image);
    parseLevels(image);
    unifyUnits();
    parseChannels();
    return std::move(out_);
  }

 private:
  [[noreturn]] void refuse(const std::string& why, const std::string& remedy) const {
    throw VolumeError(file_.string(), why, remedy);
  }

  void parseAxes(const Json& image) {
    const auto axes = image.find("axes");
    constexpr std::size_t kMostAxes = 5;
    if (axes == image.end() || !axes->is_array() || axes->empty() || axes->size() > kMostAxes) {
      refuse("the image has no list \"axes\" of 2 to 5 axes", kCorrectOme);
    }
    out_.axes = axes->size();
    std::vector<std::size_t> space;
    for (std::size_t a = 0; a < out_.axes; ++a) {
      const Json& axis = (*axes)[a];
      const std::string name = textAt(axis, "name");
      if (name.empty()) refuse(fmt::format("axis {} has no \"name\"", a), kCorrectOme);
      names_.push_back(name);
      units_.push_back(textAt(axis, "unit"));
      std::string type = textAt(axis, "type");
      if (type.empty()) {
        type = name == "t"                                 ? "time"
               : name == "x" || name == "y" || name == "z" ? "space"
                                                           : "channel";
      }
      if (type == "space") {
        space.push_back(a);
        continue;
      }
      int& one = type == "time" ? out_.time : out_.channel;
      if (one >= 0) {
        refuse(fmt::format("the axes {} and {} are both of the type \"{}\"",
                           names_[static_cast<std::size_t>(one)], name, type),
               "export a part of the image with the axes t, c, z, y and x");
      }
      one = static_cast<int>(a);
    }
    if (space.size() != 3) {
      refuse(fmt::format("the image has {} axes in space, not 3", space.size()),
             "export a volume with the axes z, y and x");
    }
    placeAxes(space);
  }

  /// Finds x, y and z by their names. If other names are used, the last axis is x.
  void placeAxes(const std::vector<std::size_t>& space) {
    out_.space = {space[2], space[1], space[0]};
    std::array<std::size_t, 3> named{};
    std::size_t found = 0;
    for (std::size_t d = 0; d < 3; ++d) {
      for (const std::size_t a : space) {
        if (names_[a] != std::string(1, "xyz"[d])) continue;
        named[d] = a;
        ++found;
        break;
      }
    }
    if (found == 3) {
      out_.space = named;
      return;
    }
    notes_.push_back(fmt::format("the axes in space are {}, {} and {}: they are read as z, y and x",
                                 names_[space[0]], names_[space[1]], names_[space[2]]));
  }

  void parseLevels(const Json& image) {
    const auto levels = image.find("datasets");
    if (levels == image.end() || !levels->is_array() || levels->empty()) {
      refuse("the image has no list \"datasets\"", kCorrectOme);
    }
    OmeLevel all;
    if (image.contains("coordinateTransformations")) {
      transform(image["coordinateTransformations"], "the image", all);
    } else {
      all.scale.assign(out_.axes, 1.0);
      all.translation.assign(out_.axes, 0.0);
    }
    for (std::size_t n = 0; n < levels->size(); ++n) {
      const Json& json = (*levels)[n];
      OmeLevel level;
      level.path = textAt(json, "path");
      const std::string what = fmt::format("level {}", n);
      if (level.path.empty()) refuse(what + " has no \"path\"", kCorrectOme);
      if (!json.contains("coordinateTransformations")) {
        refuse(what + " has no \"coordinateTransformations\"", kCorrectOme);
      }
      transform(json["coordinateTransformations"], what, level);
      for (std::size_t a = 0; a < out_.axes; ++a) {
        level.scale[a] *= all.scale[a];
        level.translation[a] = all.translation[a] + all.scale[a] * level.translation[a];
      }
      out_.levels.push_back(std::move(level));
    }
  }

  /// Reads one scale, and an optional translation after it.
  void transform(const Json& list, const std::string& what, OmeLevel& level) const {
    level.translation.assign(out_.axes, 0.0);
    for (const Json& one : list.is_array() ? list : Json::array()) {
      const std::string type = textAt(one, "type");
      const bool is_scale = type == "scale" && level.scale.empty();
      const bool is_translation = type == "translation" && !level.scale.empty();
      if (!is_scale && !is_translation) {
        refuse(fmt::format("{} has the transformation \"{}\", not a scale and then a translation",
                           what, type),
               kCorrectOme);
      }
      (is_scale ? level.scale : level.translation) = numbers(one, type, what);
    }
    if (level.scale.empty()) refuse(what + " has no transformation \"scale\"", kCorrectOme);
  }

  [[nodiscard]] std::vector<double> numbers(const Json& json, const std::string& key,
                                            const std::string& what) const {
    const auto list = json.find(key);
    std::vector<double> out;
    for (const Json& number : list != json.end() && list->is_array() ? *list : Json::array()) {
      if (number.is_number()) out.push_back(number.get<double>());
    }
    const bool fits = std::all_of(out.begin(), out.end(), [&](double number) {
      return std::isfinite(number) && (key != "scale" || number > 0.0);
    });
    if (out.size() != out_.axes || list->size() != out_.axes || !fits) {
      refuse(fmt::format("the {} of {} is not a list of {} {}numbers, one for each axis", key, what,
                         out_.axes, key == "scale" ? "positive " : ""),
             kCorrectOme);
    }
    return out;
  }

  /// Converts positions to the unit of x. If units differ and one is unknown, the result has no
  /// unit.
  void unifyUnits() {
    if (out_.time >= 0) out_.time_unit = units_[static_cast<std::size_t>(out_.time)];
    const std::string& unit = units_[out_.space[0]];
    const LengthUnit* known = lengthUnitOf(unit);
    out_.unit = known == nullptr ? unit : known->unit;
    for (const std::size_t a : out_.space) {
      if (units_[a] == unit) continue;
      const LengthUnit* other = lengthUnitOf(units_[a]);
      if (known == nullptr || other == nullptr) {
        notes_.push_back(
            fmt::format("the axes have different units ({}), so the unit of length is unknown",
                        fmt::join(unitsInSpace(), ", ")));
        out_.unit.clear();
        return;
      }
    }
    for (const std::size_t a : out_.space) {
      if (units_[a] == unit) continue;
      const double factor = lengthUnitOf(units_[a])->metres / known->metres;
      for (OmeLevel& level : out_.levels) {
        level.scale[a] *= factor;
        level.translation[a] *= factor;
      }
    }
  }

  [[nodiscard]] std::vector<std::string> unitsInSpace() const {
    std::vector<std::string> units;
    for (const std::size_t a : out_.space) units.push_back(units_[a].empty() ? "none" : units_[a]);
    return units;
  }

  void parseChannels() {
    const auto omero = json_.find("omero");
    if (omero == json_.end() || !omero->is_object() || !omero->contains("channels")) return;
    for (const Json& channel : (*omero)["channels"]) {
      out_.channels.push_back(textAt(channel, "label"));
    }
  }

  const Json& json_;
  const std::filesystem::path& file_;
  std::vector<std::string>& notes_;
  std::vector<std::string> names_;
  std::vector<std::string> units_;
  OmeImage out_;
};

}  // namespace

OmeImage parseOmeImage(const Json& json, const std::filesystem::path& file,
                       std::vector<std::string>& notes) {
  return OmeParser(json, file, notes).parse();
}

}  // namespace palpate::importer
