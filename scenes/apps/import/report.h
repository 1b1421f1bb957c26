/// Reports the result of an import.
#pragma once

#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

#include "palpate/scenes/apps/import/importer.h"

namespace palpate::importer {

/// Returns the report as text: the file, its grids and the losses, one line each.
[[nodiscard]] std::string textOf(const std::filesystem::path& out, const Step& step);

/// Returns the peak memory use of this process so far [bytes].
[[nodiscard]] std::uint64_t peakMemory();

/// Returns the report in the format that docs/formats.md defines, without the entry memory.peak.
[[nodiscard]] nlohmann::ordered_json jsonOf(const std::filesystem::path& out, const Step& step);

}  // namespace palpate::importer
