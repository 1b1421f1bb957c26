/// Writes the results of benchmarks as JSON, with the machine on which they were measured.
#pragma once

#include <string>

#include <nlohmann/json.hpp>

#include "bench/machine.h"

namespace palpate::bench {

/// Prints progress to standard error, if that is a terminal. An empty string clears the line.
void tell(const std::string& what);

/// Rounds to four significant digits, because further digits would be noise.
[[nodiscard]] double rounded(double x);

[[nodiscard]] nlohmann::ordered_json asJson(const Machine& machine);

/// Writes a JSON object to `file`, or to standard output if `file` is empty. Each element of the
/// object's lists has its own line. Throws if the writing fails.
void writeResult(const nlohmann::ordered_json& result, const std::string& file);

}  // namespace palpate::bench
