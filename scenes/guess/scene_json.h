/// Private to scene guesses and imports: makes the JSON of modes, and formats JSON.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

namespace palpate::guess {

using Json = nlohmann::ordered_json;
/// Points of a curve: pairs of an input and a strength [N], in ascending order of the inputs.
using Knots = std::vector<std::pair<double, double>>;

[[nodiscard]] std::string inlined(const Json& json);

/// Formats JSON with indentation, and short items on one line.
[[nodiscard]] std::string indented(const Json& json, std::size_t depth = 0);

/// Returns a curve. Drops inner points that are so near to others that the strength would be noisy.
[[nodiscard]] Json curve(const Knots& knots);

/// Returns a mode; `more` has the keys of its kind.
[[nodiscard]] Json makeMode(const std::string& name, const char* kind, const std::string& of,
                            const Json& more, const Json& strength, const std::string& description);

/// Returns an isosurface. The solid is above or below `value`. `strength` is in N.
[[nodiscard]] Json isosurface(const std::string& name, const std::string& of, double value,
                              bool above, double strength, const std::string& description);

/// Restricts a mode to points where the volume `region` has data.
void confine(Json& mode, const std::string& region);

[[nodiscard]] Json drag(const std::string& name, const std::string& of, const Knots& knots,
                        const std::string& description);

}  // namespace palpate::guess
