/// What an import says of itself.
#pragma once

#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

#include "palpate/scenes/import/importer.h"

namespace palpate::importer {

/// For people: the file, its grids and what was lost, a line each.
[[nodiscard]] std::string textOf(const std::filesystem::path& out, const Step& step);

/// Of this process so far [bytes].
[[nodiscard]] std::uint64_t peakMemory();

/// The same, as docs/formats.md has it, but for memory.peak.
[[nodiscard]] nlohmann::ordered_json jsonOf(const std::filesystem::path& out, const Step& step);

}  // namespace palpate::importer
