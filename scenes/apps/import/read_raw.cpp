/// Reads files without a header, whose layout the user states.
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <fstream>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/unpacked.h"
#include "palpate/scenes/library/text_file.h"

namespace palpate::importer {
namespace {

using Json = nlohmann::json;

/// Layout of the values, as docs/import.md describes it.
struct Layout {
  std::array<int, 3> size{};
  Type type = Type::kUint8;
  bool big_endian = false;
  int components = 1;
  bool planar = false;  ///< True if all x components come first, then all y, then all z.
  /// Number of bytes before the values; -1: the values end at the end of the file.
  std::int64_t skip = 0;
  std::string after;
  Affine map;
  std::string name = "density";
  std::string length_unit;
};

/// Parses a layout. Each error names the key at fault.
class LayoutParser {
 public:
  LayoutParser(const Json& json, std::string source) : json_(json), source_(std::move(source)) {}

  Layout parse() {
    if (!json_.is_object()) refuse("", "the layout is not a JSON object", kRemedy);
    static const std::vector<std::string> keys{"size",   "type", "endian",  "components",
                                               "order",  "skip", "spacing", "axes",
                                               "origin", "name", "unit",    "description"};
    for (const auto& [key, value] : json_.items()) {
      if (std::find(keys.begin(), keys.end(), key) == keys.end()) {
        refuse("/" + key, "a layout has no such key",
               fmt::format("use the keys {}", fmt::join(keys, ", ")));
      }
    }
    Layout layout;
    const std::vector<double> size = numbers("size", 3);
    for (std::size_t a = 0; a < 3; ++a) {
      if (!(size[a] >= 1.0 && size[a] <= 1e6 && size[a] == std::floor(size[a]))) {
        refuse("/size", fmt::format("{} is not a count from 1 to 1e6", size[a]),
               "give the numbers of points along i, j and k");
      }
      layout.size[a] = static_cast<int>(size[a]);
    }
    const std::string type = text("type");
    const std::optional<Type> known = typeNamed(type);
    if (!known) {
      refuse("/type", fmt::format("the type \"{}\" is unknown", type),
             "give int8, uint8, int16, uint16, int32, uint32, int64, uint64, float32 or float64");
    }
    layout.type = *known;
    if (json_.contains("endian")) {
      const std::string endian = text("endian");
      if (endian != "little" && endian != "big") {
        refuse("/endian", fmt::format("the value \"{}\" is unknown", endian), "give little or big");
      }
      layout.big_endian = endian == "big";
    }
    if (json_.contains("components")) {
      const Json& components = json_["components"];
      if (components != 1 && components != 3)
        refuse("/components", "the value is not 1 or 3", "give 1 or 3");
      layout.components = components.get<int>();
    }
    if (json_.contains("order")) {
      const std::string order = text("order");
      if (order != "interleaved" && order != "planar") {
        refuse("/order", fmt::format("the value \"{}\" is unknown", order),
               "give interleaved or planar");
      }
      layout.planar = order == "planar";
    }
    if (json_.contains("skip")) parseSkip(layout);
    if (json_.contains("spacing") && json_.contains("axes")) {
      refuse("/spacing", "\"axes\" already states the spacing", "give one of the two");
    }
    if (json_.contains("spacing")) {
      const std::vector<double> spacing = numbers("spacing", 3);
      layout.map.linear = Vec3(spacing[0], spacing[1], spacing[2]).asDiagonal();
    }
    if (json_.contains("axes")) parseAxes(layout);
    if (json_.contains("origin")) {
      const std::vector<double> origin = numbers("origin", 3);
      layout.map.origin = Vec3(origin[0], origin[1], origin[2]);
    }
    if (json_.contains("name")) layout.name = text("name");
    if (json_.contains("unit")) layout.length_unit = text("unit");
    return layout;
  }

 private:
  static constexpr const char* kRemedy =
      R"(write a layout as in {"size": [64, 64, 93], "type": "int16", "spacing": [3.2, 3.2, 1.5]})";

  [[noreturn]] void refuse(const std::string& path, const std::string& why,
                           const std::string& remedy) const {
    throw VolumeError(source_ + path, why, remedy);
  }

  std::string text(const char* key) {
    if (!json_.contains(key)) refuse("", fmt::format("\"{}\" is missing", key), kRemedy);
    if (!json_[key].is_string() || json_[key].get<std::string>().empty()) {
      refuse(std::string("/") + key, "the value is empty, or is not a string", kRemedy);
    }
    return json_[key].get<std::string>();
  }

  std::vector<double> numbersOf(const Json& json, const std::string& path,
                                std::size_t count) const {
    std::vector<double> out;
    for (const Json& value : json.is_array() ? json : Json::array()) {
      if (value.is_number() && std::isfinite(value.get<double>()))
        out.push_back(value.get<double>());
    }
    if (out.size() != count || json.size() != count) {
      refuse(path, fmt::format("the value is not a list of {} numbers", count), kRemedy);
    }
    return out;
  }
  std::vector<double> numbers(const char* key, std::size_t count) {
    if (!json_.contains(key)) refuse("", fmt::format("\"{}\" is missing", key), kRemedy);
    return numbersOf(json_[key], std::string("/") + key, count);
  }

  void parseSkip(Layout& layout) const {
    const Json& skip = json_["skip"];
    constexpr double kMost = 1e18;  // [bytes]: larger numbers are errors
    if (skip.is_number_integer() && skip.get<double>() >= -1.0 && skip.get<double>() < kMost) {
      layout.skip = skip.get<std::int64_t>();
    } else if (skip.is_object() && skip.size() == 1 && skip.contains("after") &&
               skip["after"].is_string() && !skip["after"].get<std::string>().empty()) {
      layout.after = skip["after"].get<std::string>();
    } else {
      refuse(
          "/skip", "the value is not a number of bytes",
          R"(give a number of bytes, -1 if the values are last in the file, or {"after": "text"})");
    }
  }

  void parseAxes(Layout& layout) const {
    const Json& axes = json_["axes"];
    if (!axes.is_array() || axes.size() != 3) {
      refuse("/axes", "the value is not a list of three vectors",
             "give the steps along i, j and k, as in [[1,0,0],[0,1,0],[0,0,1]]");
    }
    for (std::size_t a = 0; a < 3; ++a) {
      const std::vector<double> axis = numbersOf(axes[a], fmt::format("/axes/{}", a), 3);
      layout.map.linear.col(static_cast<Eigen::Index>(a)) = Vec3(axis[0], axis[1], axis[2]);
    }
  }

  const Json& json_;
  std::string source_;
};

Layout layoutOf(const std::string& raw) {
  std::string text = raw;
  std::string source = "--raw";
  if (raw.find('{') == std::string::npos) {
    source = raw;
    text = readText<VolumeError>(raw, "give the path of a layout file, or the layout as JSON");
  }
  Json json;
  try {
    json = Json::parse(text);
  } catch (const Json::parse_error& e) {
    throw VolumeError(source, fmt::format("the layout is not JSON (byte {})", e.byte),
                      "correct the text at this byte");
  } catch (const Json::out_of_range&) {
    throw VolumeError(source, "a number is too large for a double", "correct the number");
  }
  return LayoutParser(json, source).parse();
}

std::uint64_t offsetOf(std::ifstream& in, const Layout& layout, std::uint64_t needed,
                       std::uint64_t have, const std::string& file) {
  if (!layout.after.empty()) {
    // Searches only the first megabyte, because headers are short.
    std::string head(std::min<std::uint64_t>(have, 1U << 20U), '\0');
    in.read(head.data(), static_cast<std::streamsize>(head.size()));
    const auto at = head.find(layout.after);
    if (at == std::string::npos) {
      throw VolumeError(file, "the text of \"skip\" is not in the first megabyte of the file",
                        "check the text, or give a number of bytes");
    }
    return at + layout.after.size();
  }
  if (layout.skip == -1) {
    if (have < needed) return 0;
    return have - needed;
  }
  return static_cast<std::uint64_t>(layout.skip);
}

class RawReader final : public Reader {
 public:
  explicit RawReader(const Request& request) : request_(request), layout_(layoutOf(request.raw)) {}

  Content read(std::size_t /*step*/) override {
    const std::string file = request_.file.string();
    (void)bytesOf(request_.file, {layout_.size.begin(), layout_.size.end()},
                  static_cast<double>(bytesOf(layout_.type)) * layout_.components);
    const auto points = static_cast<std::uint64_t>(layout_.size[0]) *
                        static_cast<std::uint64_t>(layout_.size[1]) *
                        static_cast<std::uint64_t>(layout_.size[2]);
    const std::uint64_t count = points * static_cast<std::uint64_t>(layout_.components);
    const std::uint64_t needed = count * bytesOf(layout_.type);
    std::error_code error;
    const std::uint64_t have = std::filesystem::file_size(request_.file, error);
    std::ifstream in(request_.file, std::ios::binary);
    if (error || !in) throw VolumeError(file, "the file cannot be read", "check the permissions");
    const std::uint64_t offset = offsetOf(in, layout_, needed, have, file);
    if (offset > have || have - offset < needed) {
      throw VolumeError(
          file,
          fmt::format("the layout needs {} bytes from byte {}, but the file has {} bytes", needed,
                      offset, have),
          isGzip(request_.file) ? "unpack the file with gunzip, which --raw does not do"
                                : "check size, type, components and skip, or copy the file again");
    }
    Piece image;
    image.size = layout_.size;
    image.file_from_index = layout_.map;
    const Slab slices = slicesToRead(request_, image);
    const std::uint64_t slice = points / static_cast<std::uint64_t>(layout_.size[2]);
    const Values values(layout_.type, layout_.components,
                        slice * static_cast<std::uint64_t>(slices.count));
    in.clear();
    auto* bytes = values.as<char>();
    readValues(in, offset, points, slice * static_cast<std::uint64_t>(slices.first), values);
    if (!in) throw VolumeError(file, "the file cannot be read to the end", "copy the file again");
    if (layout_.big_endian != (std::endian::native == std::endian::big)) {
      swapBytes(bytes, values.size(), bytesOf(layout_.type));
    }

    image.arrays.push_back({layout_.name, values, "", "", false});
    Content content;
    content.pieces.push_back(std::move(image));
    content.length_unit = layout_.length_unit;
    if (have - offset > needed && layout_.after.empty() && layout_.skip >= 0) {
      content.notes.push_back(
          fmt::format("{} bytes after the values were not read", have - offset - needed));
    }
    return content;
  }

 private:
  /// Reads values from point `first` of `points` on. Interleaves planar components.
  void readValues(std::ifstream& in, std::uint64_t offset, std::uint64_t points,
                  std::uint64_t first, const Values& values) const {
    const std::size_t width = bytesOf(layout_.type);
    const auto components = static_cast<std::size_t>(layout_.components);
    auto* bytes = values.as<char>();
    if (!layout_.planar || layout_.components == 1) {
      in.seekg(static_cast<std::streamoff>(offset + first * width * components));
      in.read(bytes, static_cast<std::streamsize>(values.size() * width));
      return;
    }
    std::vector<char> plane(values.tuples() * width);
    for (std::size_t c = 0; c < components; ++c) {
      in.seekg(static_cast<std::streamoff>(offset + (c * points + first) * width));
      in.read(plane.data(), static_cast<std::streamsize>(plane.size()));
      for (std::size_t p = 0; p < values.tuples(); ++p) {
        std::memcpy(bytes + (p * components + c) * width, plane.data() + p * width, width);
      }
    }
  }

  Request request_;
  Layout layout_;
};

}  // namespace

std::unique_ptr<Reader> openRaw(const Request& request) {
  return std::make_unique<RawReader>(request);
}

}  // namespace palpate::importer
