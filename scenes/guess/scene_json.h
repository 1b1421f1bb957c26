/// Private to the scene guess: JSON of modes, and its layout for people.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

namespace palpate::guess {

using Json = nlohmann::ordered_json;
/// Pairs of an input and a strength [N], ascending by input.
using Knots = std::vector<std::pair<double, double>>;

/// Formats JSON on one line, with spaces.
[[nodiscard]] std::string inlined(const Json& json);

/// Formats JSON for people, with small items on one line.
[[nodiscard]] std::string indented(const Json& json, std::size_t depth = 0);

/// Makes a strength curve. Drops inner knots that are so near to the one before, or to the last,
/// that the strength would depend on noise in the data.
[[nodiscard]] Json curve(const Knots& knots);

/// Makes a mode with the keys of all modes, in reading order; `more` are the mode's own keys.
[[nodiscard]] Json makeMode(const std::string& name, const char* kind, const std::string& of,
                            const Json& more, const Json& strength, const std::string& description);

/// Makes an isosurface that is solid above or below its value. `strength` is in N.
[[nodiscard]] Json isosurface(const std::string& name, const std::string& of, double value,
                              bool above, double strength, const std::string& description);

/// Makes a viscosity by the value of a scalar.
[[nodiscard]] Json drag(const std::string& name, const std::string& of, const Knots& knots,
                        const std::string& description);

}  // namespace palpate::guess
