#include "palpate/devices/json/json_node.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

std::string listed(const std::vector<std::string>& names) {
  std::string all;
  for (const std::string& name : names) all += (all.empty() ? "" : ", ") + name;
  return all;
}

constexpr std::size_t kMostLevels = 64;

/// Builds a document and finds keys that occur twice in one object. Takes linear time for an array;
/// the library's own callback parser takes quadratic time.
class DocumentReader final : public Json::json_sax_t {
 public:
  [[nodiscard]] Json takeDocument() { return std::move(document_); }
  [[nodiscard]] const std::string& syntaxError() const { return error_; }
  [[nodiscard]] const std::optional<std::string>& repeatedKey() const { return repeated_; }
  [[nodiscard]] bool isTooDeep() const { return too_deep_; }

  bool null() override { return add(nullptr); }
  bool boolean(bool value) override { return add(value); }
  bool number_integer(Json::number_integer_t value) override { return add(value); }
  bool number_unsigned(Json::number_unsigned_t value) override { return add(value); }
  bool number_float(Json::number_float_t value, const std::string& /*text*/) override {
    return add(value);
  }
  bool string(std::string& value) override { return add(std::move(value)); }
  bool binary(Json::binary_t& value) override { return add(Json::binary(std::move(value))); }
  bool start_object(std::size_t /*elements*/) override { return open(Json::object()); }
  bool start_array(std::size_t /*elements*/) override { return open(Json::array()); }
  bool end_object() override { return close(); }
  bool end_array() override { return close(); }
  bool key(std::string& name) override {
    auto& members = open_.back()->get_ref<Json::object_t&>();
    const auto [member, is_new] = members.try_emplace(std::move(name));
    if (!is_new && !repeated_) repeated_ = member->first;
    next_ = &member->second;
    return true;
  }
  bool parse_error(std::size_t /*position*/, const std::string& /*token*/,
                   const Json::exception& error) override {
    error_ = error.what();
    const auto bracket = error_.find("] ");
    if (bracket != std::string::npos) error_.erase(0, bracket + 2);
    std::replace(error_.begin(), error_.end(), '\n', ' ');
    return false;
  }

 private:
  /// Stores a value; `next_` then points to it.
  bool add(Json value) {
    if (!open_.empty() && open_.back()->is_array()) {
      auto& elements = open_.back()->get_ref<Json::array_t&>();
      next_ = &elements.emplace_back(std::move(value));
    } else {
      *next_ = std::move(value);
    }
    return true;
  }
  bool open(Json value) {
    too_deep_ = open_.size() == kMostLevels;
    if (too_deep_) return false;
    add(std::move(value));
    open_.push_back(next_);
    return true;
  }
  bool close() {
    open_.pop_back();
    return true;
  }

  Json document_;
  /// Place of the next value, unless the value is an element of an array.
  Json* next_ = &document_;
  std::vector<Json*> open_;  ///< Open objects and arrays, outermost first.
  std::optional<std::string> repeated_;
  std::string error_;
  bool too_deep_ = false;
};

}  // namespace

void JsonNode::fail(const std::string& why, const std::string& remedy) const {
  raise_(source_ + ": " + (path_.empty() ? "/" : path_), why, remedy);
  throw Error(source_, why, remedy);  // a JsonRaise throws and does not return
}

JsonNode JsonNode::child(const std::string& key) const {
  return {json_->at(key), source_, path_ + "/" + key, raise_};
}

JsonNode JsonNode::need(const std::string& key) const {
  if (!has(key)) fail("\"" + key + "\" is missing", "add it");
  return child(key);
}

JsonNode JsonNode::element(std::size_t i) const {
  return {json_->at(i), source_, path_ + "/" + std::to_string(i), raise_};
}

const JsonNode& JsonNode::object(const std::vector<std::string>& keys,
                                 const std::vector<std::string>& also) const {
  if (!json_->is_object()) fail("it is not an object", "write { ... }");
  for (const auto& [key, value] : json_->items()) {
    if (std::find(keys.begin(), keys.end(), key) != keys.end()) continue;
    if (std::find(also.begin(), also.end(), key) != also.end()) continue;
    const std::string near = nearestName(key, keys);
    child(key).fail("unknown key",
                    near.empty() ? "use one of " + listed(keys) : "did you mean \"" + near + "\"?");
  }
  return *this;
}

double JsonNode::number() const {
  if (!json_->is_number()) fail(json_->dump() + " is not a number", "write a number");
  const auto value = json_->get<double>();
  if (!std::isfinite(value)) fail("it is not finite", "write a finite number");
  return value;
}

double JsonNode::positive() const {
  const double value = number();
  if (value <= 0.0) fail(json_->dump() + " is not > 0", "write a number > 0");
  return value;
}

double JsonNode::notNegative() const {
  const double value = number();
  if (value < 0.0) fail(json_->dump() + " is negative", "write a number >= 0");
  return value;
}

double JsonNode::sized(double most, const char* unit) const {
  const double value = number();
  if (std::abs(value) > most) {
    fail(value > 0.0 ? fmt::format("{} is more than {} {}", json_->dump(), most, unit)
                     : fmt::format("{} is less than -{} {}", json_->dump(), most, unit),
         std::string("write the number in ") + unit);
  }
  return value;
}

std::string JsonNode::text() const {
  if (!json_->is_string()) fail(json_->dump() + " is not a text", "write a text in quotes");
  return json_->get<std::string>();
}

std::string JsonNode::name() const {
  std::string value = text();
  if (value.empty()) fail("the text is empty", "write a name");
  return value;
}

bool JsonNode::flag() const {
  if (!json_->is_boolean()) fail(json_->dump() + " is not true or false", "write true or false");
  return json_->get<bool>();
}

int JsonNode::whole(int least, int most) const {
  const double value = number();
  if (value != std::floor(value) || value < least || value > most) {
    fail(fmt::format("{} is not a whole number from {} to {}", json_->dump(), least, most),
         "write a whole number in this range");
  }
  return static_cast<int>(value);
}

std::size_t JsonNode::wordAmong(const std::vector<std::string>& words) const {
  const std::string value = text();
  const auto found = std::find(words.begin(), words.end(), value);
  if (found != words.end()) return static_cast<std::size_t>(found - words.begin());
  const std::string near = nearestName(value, words);
  fail("\"" + value + "\" is not known",
       near.empty() ? "use one of " + listed(words) : "did you mean \"" + near + "\"?");
}

Json parseJson(const std::string& text, const std::string& source, JsonRaise raise) {
  DocumentReader reader;
  Json::sax_parse(text, &reader);
  if (reader.isTooDeep()) {
    raise(source, fmt::format("it is nested deeper than {} levels", kMostLevels),
          "use fewer levels");
  }
  if (!reader.syntaxError().empty()) {
    raise(source, "it is not valid JSON (" + reader.syntaxError() + ")",
          "correct the syntax or the number there");
  }
  if (reader.repeatedKey()) {
    raise(source, "the key \"" + *reader.repeatedKey() + "\" occurs twice in one object",
          "remove one of them");
  }
  return reader.takeDocument();
}

}  // namespace palpate
