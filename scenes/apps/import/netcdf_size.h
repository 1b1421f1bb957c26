/// Computes the length that a netCDF file should have. The netCDF library reads zeros beyond the
/// end of a truncated file, so the importer checks the length.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>

namespace palpate::importer {

/// Returns the size of a classic netCDF file (CDF-1, CDF-2 or CDF-5) according to its header
/// [bytes]. Returns no value for other files or an invalid header. Source: NetCDF Classic Format
/// Specification.
[[nodiscard]] std::optional<std::uint64_t> netcdfSize(const std::filesystem::path& file);

}  // namespace palpate::importer
