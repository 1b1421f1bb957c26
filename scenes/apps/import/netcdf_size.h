#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>

namespace palpate::importer {

/// Returns the size that the header of a classic netCDF file states [bytes]; no value for other
/// files (NetCDF Classic Format Specification). The library reads zeros beyond the end of a file.
[[nodiscard]] std::optional<std::uint64_t> netcdfSize(const std::filesystem::path& file);

}  // namespace palpate::importer
