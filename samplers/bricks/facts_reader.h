/// Private to samplers, for .cpp files only: reads values of the manifest of bricks.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "palpate/engine/types.h"
#include "palpate/samplers/bricks/bricks.h"

namespace palpate {

/// Largest magnitude of a voxel's coordinate, so that coordinate plus edge of a brick fits into 32
/// bits.
inline constexpr std::int32_t kFarthestVoxel = 1 << 30;

/// Returns the beginning of a value's JSON text, in ASCII, for messages.
inline std::string jsonStart(const nlohmann::ordered_json& json) {
  constexpr std::size_t kLongest = 40;
  return json.dump(-1, ' ', true, nlohmann::ordered_json::error_handler_t::replace)
      .substr(0, kLongest);
}

/// Reads and checks values in an object of a manifest's JSON. Throws std::range_error, whose text
/// names the key.
class FactsReader {
  using Json = nlohmann::ordered_json;

  template <class Convert>
  auto read(const char* key, Convert convert) const {
    const Json& json = at(key);
    try {
      return convert(json);
    } catch (const std::range_error& e) {
      throw std::range_error("\"" + path_ + key + "\": " + e.what());
    }
  }

  static std::string toText(const Json& json) {
    if (!json.is_string())
      throw std::range_error("the value " + jsonStart(json) + " is not a text");
    return json.get<std::string>();
  }
  static double toNumber(const Json& json) {
    const double v = json.is_number() ? json.get<double>() : std::nan("");
    if (!std::isfinite(v))
      throw std::range_error("the value " + jsonStart(json) + " is not a finite number");
    return v;
  }
  static std::int32_t toWhole(const Json& json) {
    const double v = toNumber(json);
    if (!(std::abs(v) <= kFarthestVoxel) || v != std::floor(v)) {
      throw std::range_error("the value " + jsonStart(json) +
                             " is not an integer from -2^30 to 2^30");
    }
    return static_cast<std::int32_t>(v);
  }
  static const Json& toList(const Json& json, std::size_t size) {
    if (!json.is_array() || json.size() != size) {
      throw std::range_error("the value " + jsonStart(json) + " is not a list of " +
                             std::to_string(size) + (size == 1 ? " value" : " values"));
    }
    return json;
  }
  static VoxelAt toVoxel(const Json& json) {
    const Json& three = toList(json, 3);
    return {toWhole(three[0]), toWhole(three[1]), toWhole(three[2])};
  }
  static Vec3 toVec(const Json& json) {
    const Json& three = toList(json, 3);
    return {toNumber(three[0]), toNumber(three[1]), toNumber(three[2])};
  }

 public:
  /// @param path  Path of the object, such as "statistics/".
  explicit FactsReader(const Json& json, std::string path = "")
      : json_(json), path_(std::move(path)) {}

  /// Returns a text.
  [[nodiscard]] std::string text(const char* key) const { return read(key, toText); }
  /// Returns a finite number.
  [[nodiscard]] double number(const char* key) const { return read(key, toNumber); }
  /// Returns an integer of magnitude at most kFarthestVoxel.
  [[nodiscard]] std::int32_t whole(const char* key) const { return read(key, toWhole); }
  /// Returns three integers.
  [[nodiscard]] VoxelAt voxel(const char* key) const { return read(key, toVoxel); }
  /// Returns three numbers.
  [[nodiscard]] Vec3 vec(const char* key) const { return read(key, toVec); }
  /// Returns three rows of three numbers.
  [[nodiscard]] Mat3 matrix(const char* key) const {
    return read(key, [](const Json& json) {
      const Json& rows = toList(json, 3);
      Mat3 m;
      for (std::size_t r = 0; r < 3; ++r) m.row(static_cast<Eigen::Index>(r)) = toVec(rows[r]);
      return m;
    });
  }
  /// Returns a list of `size` numbers.
  [[nodiscard]] std::vector<double> numbers(const char* key, std::size_t size) const {
    return read(key, [&](const Json& json) {
      std::vector<double> all;
      for (const Json& one : toList(json, size)) all.push_back(toNumber(one));
      return all;
    });
  }
  /// Returns a number of 16 hexadecimal digits.
  [[nodiscard]] std::uint64_t hexadecimal(const char* key) const {
    return read(key, [](const Json& json) {
      const std::string text = toText(json);
      if (text.size() != 16 || text.find_first_not_of("0123456789abcdef") != std::string::npos) {
        throw std::range_error("the value " + jsonStart(json) + " is not 16 hexadecimal digits");
      }
      return std::stoull(text, nullptr, 16);
    });
  }
  /// Returns the value of a key that must exist.
  [[nodiscard]] const Json& at(const char* key) const {
    const auto found = json_.is_object() ? json_.find(key) : json_.end();
    if (found == json_.end()) throw std::range_error("it has no \"" + path_ + key + "\"");
    return *found;
  }

 private:
  const Json& json_;
  std::string path_;
};

}  // namespace palpate
