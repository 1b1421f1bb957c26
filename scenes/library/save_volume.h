/// Writes a volume in memory as a .vdb. Includes no OpenVDB header.
#pragma once

#include <filesystem>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Writes a volume's grid, or its three grids of components, into a .vdb, as they are in memory: a
/// smoothed volume stays smoothed. No other thread or process may use the file. Throws Error if the
/// file cannot be written. Throws VolumeError, with the volume's name, for a staggered volume, and
/// if `half` is true and a number is too large for 16 bits. Slow: writes every value.
/// @param half  True to round values to 16 bits.
void saveVolume(const std::filesystem::path& file, const Volume& volume, bool half);

}  // namespace palpate
