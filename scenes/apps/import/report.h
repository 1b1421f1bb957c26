/// Reports the result of an import.
#pragma once

#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

#include "palpate/scenes/apps/import/importer.h"

namespace palpate::importer {

/// Returns the report as text: the file, its grids and losses, a line each.
[[nodiscard]] std::string textOf(const std::filesystem::path& out, const Step& step);

/// Returns the peak memory of this process so far [bytes].
[[nodiscard]] std::uint64_t peakMemory();

/// Returns the report as docs/formats.md defines it, without memory.peak.
[[nodiscard]] nlohmann::ordered_json jsonOf(const std::filesystem::path& out, const Step& step);

}  // namespace palpate::importer
