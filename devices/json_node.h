/// Private to devices and scenes: reading JSON files that people write, every value checked, every
/// trouble one line with its path.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <initializer_list>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "palpate/devices/json_schema.h"
#include "palpate/engine/error.h"

namespace palpate {

using Json = nlohmann::json;

/// A value of a file and its path; every reading checks and names what is wrong, as a Trouble: a
/// SceneError, a DeviceError.
template <class Trouble>
class JsonNode {
 public:
  JsonNode(const Json& json, std::string source, std::string path)
      : json_(&json), source_(std::move(source)), path_(std::move(path)) {}

  [[noreturn]] void fail(const std::string& why, const std::string& remedy) const {
    throw Trouble(source_ + ": " + (path_.empty() ? "/" : path_), why, remedy);
  }
  [[nodiscard]] bool has(const char* key) const { return json_->contains(key); }
  [[nodiscard]] const Json& json() const { return *json_; }

  [[nodiscard]] JsonNode child(const std::string& key) const {
    return {json_->at(key), source_, path_ + "/" + key};
  }
  [[nodiscard]] JsonNode need(const char* key) const {
    if (!has(key)) fail(std::string("\"") + key + "\" is missing", "add it");
    return child(key);
  }
  [[nodiscard]] JsonNode element(std::size_t i) const {
    return {json_->at(i), source_, path_ + "/" + std::to_string(i)};
  }

  /// An object with no other keys than these; `later` are refused for now with their own words.
  const JsonNode& object(std::initializer_list<const char*> keys,
                         std::initializer_list<const char*> later = {}) const {
    if (!json_->is_object()) fail("it is not an object", "write { ... }");
    std::vector<std::string> known(keys.begin(), keys.end());
    for (const auto& [key, value] : json_->items()) {
      if (std::find(known.begin(), known.end(), key) != known.end()) continue;
      const JsonNode here = child(key);
      if (std::find(later.begin(), later.end(), key) != later.end()) {
        here.fail("this version does not have it yet", "remove it");
      }
      const std::string near = nearestName(key, known);
      std::string all;
      for (const std::string& one : known) all += (all.empty() ? "" : ", ") + one;
      here.fail("unknown key",
                near.empty() ? "known are " + all : "did you mean \"" + near + "\"?");
    }
    return *this;
  }
  [[nodiscard]] double number() const {
    if (!json_->is_number()) fail(json_->dump() + " is not a number", "write a number");
    const auto value = json_->get<double>();
    if (!std::isfinite(value)) fail("it is not finite", "write a finite number");
    return value;
  }
  [[nodiscard]] double positive() const {
    const double value = number();
    if (value <= 0.0) fail(json_->dump() + " is not > 0", "write a number > 0");
    return value;
  }
  [[nodiscard]] double notNegative() const {
    const double value = number();
    if (value < 0.0) fail(json_->dump() + " is negative", "write a number >= 0");
    return value;
  }
  /// A number of a size that such a thing has: tells who wrote millimetres, or degrees.
  [[nodiscard]] double sized(double most, const char* unit) const {
    const double value = number();
    if (std::abs(value) > most) {
      fail(fmt::format("{} is more than {} {}", json_->dump(), most, unit),
           std::string("write it in ") + unit);
    }
    return value;
  }
  [[nodiscard]] std::string text() const {
    if (!json_->is_string()) fail(json_->dump() + " is not a text", "write it in quotes");
    return json_->get<std::string>();
  }
  [[nodiscard]] std::string name() const {
    std::string value = text();
    if (value.empty()) fail("it is empty", "write a name");
    return value;
  }
  [[nodiscard]] bool flag() const {
    if (!json_->is_boolean()) fail(json_->dump() + " is not true or false", "write true or false");
    return json_->get<bool>();
  }
  [[nodiscard]] int whole(int least, int most) const {
    const double value = number();
    if (value != std::floor(value) || value < least || value > most) {
      fail(fmt::format("{} is not a whole number from {} to {}", json_->dump(), least, most),
           "write one");
    }
    return static_cast<int>(value);
  }
  template <std::size_t N>
  [[nodiscard]] std::array<double, N> numbers() const {
    if (!json_->is_array() || json_->size() != N) {
      fail(fmt::format("it is not a list of {} numbers", N), "write [ ... ]");
    }
    std::array<double, N> values{};
    for (std::size_t i = 0; i < N; ++i) values[i] = element(i).number();
    return values;
  }
  /// Of these values the one whose word it is.
  template <class T>
  [[nodiscard]] T wordOf(std::initializer_list<T> values) const {
    std::vector<std::pair<const char*, T>> words;
    for (const T value : values) words.emplace_back(wordFor(value), value);
    return word(words);
  }
  /// The value of a word.
  template <class T>
  [[nodiscard]] T word(const std::vector<std::pair<const char*, T>>& words) const {
    const std::string value = text();
    std::string all;
    std::vector<std::string> names;
    for (const auto& [word, meaning] : words) {
      if (value == word) return meaning;
      all += (all.empty() ? "" : ", ") + std::string(word);
      names.emplace_back(word);
    }
    const std::string near = nearestName(value, names);
    fail("\"" + value + "\" is not known",
         near.empty() ? "use one of " + all : "did you mean \"" + near + "\"?");
  }

 private:
  const Json* json_;
  std::string source_;
  std::string path_;
};

/// The text as JSON: one line for a syntax error, and no key twice.
template <class Trouble>
Json parseJson(const std::string& text, const std::string& source) {
  std::vector<std::set<std::string>> open;
  std::string twice;
  const Json::parser_callback_t watch = [&](int depth, Json::parse_event_t event, Json& value) {
    if (depth > 64) {
      throw Trouble(source, "it is nested deeper than 64 levels", "a few suffice");
    }
    if (event == Json::parse_event_t::object_start) open.emplace_back();
    if (event == Json::parse_event_t::object_end) open.pop_back();
    if (event == Json::parse_event_t::key && !open.back().insert(value.get<std::string>()).second) {
      twice = value.get<std::string>();
    }
    return true;
  };
  Json json;
  try {
    json = Json::parse(text, watch);
  } catch (const Json::exception& e) {
    std::string why = e.what();
    const auto bracket = why.find("] ");
    if (bracket != std::string::npos) why.erase(0, bracket + 2);
    std::replace(why.begin(), why.end(), '\n', ' ');
    throw Trouble(source, "it is not valid JSON (" + why + ")", "mend the syntax there");
  }
  if (!twice.empty()) {
    throw Trouble(source, "the key \"" + twice + "\" stands twice in one object",
                  "remove one of them");
  }
  return json;
}

/// The schema's word on a file that our own reading has accepted.
template <class Trouble>
void validateJson(const Json& json, const std::string& schema_text, const std::string& schema_name,
                  const std::string& source) {
  if (const auto complaint = schemaComplaint(json, schema_text)) {
    throw Trouble(source + ": " + complaint->path, complaint->what, "see " + schema_name);
  }
}

}  // namespace palpate
