/// What benchmarks write: results as JSON, and where they were measured.
#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "bench/machine.h"

namespace palpate::bench {

/// On a terminal, what is being done; an empty string clears the line.
void tell(const std::string& what);

/// Four digits: more would be noise.
[[nodiscard]] double rounded(double x);

[[nodiscard]] nlohmann::ordered_json asJson(const Machine& machine);

/// Writes a result, one element of a list a line: short enough to read, long enough to compare. An
/// empty name is standard output. Throws where it cannot.
void writeResult(const nlohmann::ordered_json& result, const std::string& file);

}  // namespace palpate::bench
