/// Computes the expected length of a netCDF file: the library reads
/// zeros beyond the end of a truncated file.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>

namespace palpate::importer {

/// Returns the size of a classic netCDF file (CDF-1, CDF-2 or CDF-5) by its header [bytes]. Unset
/// for other files and for an invalid header. Follows the NetCDF Classic Format
/// Specification.
[[nodiscard]] std::optional<std::uint64_t> netcdfSize(const std::filesystem::path& file);

}  // namespace palpate::importer
