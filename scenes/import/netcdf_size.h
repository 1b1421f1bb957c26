/// How long a netCDF file should be: its library reads zeros where one has been cut.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>

namespace palpate::importer {

/// The bytes that a classic netCDF file (CDF-1, CDF-2 or CDF-5) has by its header; nothing for
/// other files and for a header that makes no sense. By the NetCDF Classic Format Specification.
[[nodiscard]] std::optional<std::uint64_t> netcdfSize(const std::filesystem::path& file);

}  // namespace palpate::importer
