#pragma once

#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

#include "palpate/scenes/apps/import/importer.h"

namespace palpate::importer {

[[nodiscard]] std::string textOf(const std::filesystem::path& out, const Step& step);

[[nodiscard]] std::uint64_t peakMemory();

/// Returns the report in the format of docs/formats.md, without the key memory.peak.
[[nodiscard]] nlohmann::ordered_json jsonOf(const std::filesystem::path& out, const Step& step);

}  // namespace palpate::importer
