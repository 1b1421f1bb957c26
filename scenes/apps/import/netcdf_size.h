#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>

namespace palpate::importer {

/// Returns the size that the header of a classic netCDF file states [bytes] (NetCDF Classic Format
/// Specification); no value for other files and invalid headers. The netCDF library would read
/// missing bytes as zeros.
[[nodiscard]] std::optional<std::uint64_t> netcdfSize(const std::filesystem::path& file);

}  // namespace palpate::importer
