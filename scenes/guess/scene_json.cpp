#include "palpate/scenes/guess/scene_json.h"

#include <cmath>

#include <fmt/format.h>

namespace palpate::guess {

std::string inlined(const Json& json) {
  if (json.is_number_float()) return fmt::format("{}", json.get<double>());
  if (!json.is_structured()) return json.dump(-1, ' ', false, Json::error_handler_t::replace);
  std::string all;
  for (const auto& [key, value] : json.items()) {
    all += all.empty() ? "" : ", ";
    if (json.is_object()) all += inlined(key) + ": ";
    all += inlined(value);
  }
  return json.is_object() ? "{" + all + "}" : "[" + all + "]";
}

std::string indented(const Json& json, std::size_t depth) {
  constexpr std::size_t kShort = 90;  // [characters]: shorter inner items are on one line
  std::string line = inlined(json);
  if (!json.is_structured() || json.empty() || (depth > 1 && line.size() < kShort)) return line;
  const std::string margin(2 * depth, ' ');
  std::string all;
  for (const auto& [key, value] : json.items()) {
    all += (all.empty() ? "\n  " : ",\n  ") + margin;
    if (json.is_object()) all += inlined(key) + ": ";
    all += indented(value, depth + 1);
  }
  all += "\n" + margin;
  return json.is_object() ? "{" + all + "}" : "[" + all + "]";
}

Json curve(const Knots& knots) {
  constexpr double kNear = 0.02;  // fraction of the range of the inputs
  const double near = kNear * std::abs(knots.back().first - knots.front().first);
  Json points = Json::array();
  double last = 0.0;
  for (std::size_t i = 0; i < knots.size(); ++i) {
    const auto& [in, out] = knots[i];
    const bool inner = i > 0 && i + 1 < knots.size();
    if (inner && (in - last < near || knots.back().first - in < near)) continue;
    points.push_back(Json::array({in, out}));
    last = in;
  }
  return Json{{"piecewise", points}};
}

Json makeMode(const std::string& name, const char* kind, const std::string& of, const Json& more,
              const Json& strength, const std::string& description) {
  Json mode;
  mode["name"] = name;
  mode["mode"] = kind;
  mode["of"] = of;
  mode.update(more);
  mode["strength"] = strength;
  mode["description"] = description;
  return mode;
}

Json isosurface(const std::string& name, const std::string& of, double value, bool above,
                double strength, const std::string& description) {
  const Json more{{"value", value}, {"solid", above ? "above" : "below"}};
  return makeMode(name, "isosurface", of, more, strength, description);
}

void confine(Json& mode, const std::string& region) {
  Json& strength = mode["strength"];
  if (strength.is_number()) {
    mode["by"] = region;
    return;
  }
  // The curve keeps its own input. The second factor is 1 in the region, and 0 where the region has
  // no data.
  const Json within{{"piecewise", {{0, 1}, {1, 1}}}, {"by", region}};
  strength = Json{{"product", Json::array({strength, within})}};
}

Json drag(const std::string& name, const std::string& of, const Knots& knots,
          const std::string& description) {
  return makeMode(name, "viscosity", of, Json::object(), curve(knots), description);
}

}  // namespace palpate::guess
