/// Private to devices and scenes: reads JSON files that people write. Checks every value, and
/// reports the first error in one line with the value's path.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace palpate {

using Json = nlohmann::json;

using JsonRaise = void (*)(const std::string& where, const std::string& why,
                           const std::string& remedy);

template <class Trouble>
[[noreturn]] void raiseAs(const std::string& where, const std::string& why,
                          const std::string& remedy) {
  throw Trouble(where, why, remedy);
}

/// A value of a JSON file and its path. The reading functions check the value. Errors name the
/// path.
class JsonNode {
 public:
  /// @param json    The value; must outlive the node.
  /// @param source  File name, for errors.
  /// @param path    Path of the value in the file, for errors.
  /// @param raise   Throws an error; must not return.
  JsonNode(const Json& json, std::string source, std::string path, JsonRaise raise)
      : json_(&json), source_(std::move(source)), path_(std::move(path)), raise_(raise) {}

  [[noreturn]] void fail(const std::string& why, const std::string& remedy) const;
  [[nodiscard]] bool has(const std::string& key) const { return json_->contains(key); }
  [[nodiscard]] const Json& json() const { return *json_; }

  [[nodiscard]] JsonNode child(const std::string& key) const;
  [[nodiscard]] JsonNode need(const std::string& key) const;
  [[nodiscard]] JsonNode element(std::size_t i) const;

  /// Checks that the value is an object whose keys are all in `keys` or `also`. Errors name `keys`
  /// only.
  const JsonNode& object(const std::vector<std::string>& keys,
                         const std::vector<std::string>& also = {}) const;
  [[nodiscard]] double number() const;
  [[nodiscard]] double positive() const;
  [[nodiscard]] double notNegative() const;
  /// Reads a number from -`most` to `most` [`unit`]. A larger number is probably in a wrong unit.
  [[nodiscard]] double sized(double most, const char* unit) const;
  [[nodiscard]] std::string text() const;
  [[nodiscard]] std::string name() const;
  [[nodiscard]] bool flag() const;
  [[nodiscard]] int whole(int least, int most) const;
  template <std::size_t N>
  [[nodiscard]] std::array<double, N> numbers() const {
    if (!json_->is_array() || json_->size() != N) {
      fail(fmt::format("it is not a list of {} numbers", N), "write [ ... ]");
    }
    std::array<double, N> values{};
    for (std::size_t i = 0; i < N; ++i) values[i] = element(i).number();
    return values;
  }
  [[nodiscard]] std::size_t wordAmong(const std::vector<std::string>& words) const;
  template <class T>
  [[nodiscard]] T word(const std::vector<std::pair<const char*, T>>& words) const {
    std::vector<std::string> names;
    names.reserve(words.size());
    for (const auto& [name, value] : words) names.emplace_back(name);
    return words[wordAmong(names)].second;
  }

 private:
  const Json* json_;
  std::string source_;
  std::string path_;
  JsonRaise raise_;
};

/// Parses a text. Rejects repeated keys. Reports a syntax error in one line.
[[nodiscard]] Json parseJson(const std::string& text, const std::string& source, JsonRaise raise);

}  // namespace palpate
