#include "palpate/devices/json/json_node.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

std::string listed(const std::vector<std::string>& names) {
  std::string all;
  for (const std::string& name : names) all += (all.empty() ? "" : ", ") + name;
  return all;
}

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
    fail(fmt::format("{} is more than {} {}", json_->dump(), most, unit),
         std::string("write it in ") + unit);
  }
  return value;
}

std::string JsonNode::text() const {
  if (!json_->is_string()) fail(json_->dump() + " is not a text", "write it in quotes");
  return json_->get<std::string>();
}

std::string JsonNode::name() const {
  std::string value = text();
  if (value.empty()) fail("it is empty", "write a name");
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
  std::vector<std::set<std::string>> open;
  std::string twice;
  const Json::parser_callback_t watch = [&](int depth, Json::parse_event_t event, Json& value) {
    if (depth > 64) {
      raise(source, "it is nested deeper than 64 levels", "use fewer levels");
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
    raise(source, "it is not valid JSON (" + why + ")", "correct the syntax there");
  }
  if (!twice.empty()) {
    raise(source, "the key \"" + twice + "\" occurs twice in one object", "remove one of them");
  }
  return json;
}

}  // namespace palpate
