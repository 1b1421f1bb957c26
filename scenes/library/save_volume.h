/// Writes a volume in memory as a .vdb. Includes no OpenVDB header.
#pragma once

#include <filesystem>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Writes a volume's grid, or its three grids of components, into a .vdb, as they are in memory: a
/// smoothed volume stays smoothed. No other thread or process may use the file. Throws Error if the
/// file cannot be written. Throws VolumeError, with the volume's name, for a volume that was
/// staggered in its file, and if `half` is true and a number is too large for 16 bits. Slow: writes
/// every value.
/// @param half  True: rounds values to 16 bits. False: writes 16 bits only if the values came from
///              a file with 16 bits, and were not smoothed.
void saveVolume(const std::filesystem::path& file, const Volume& volume, bool half);

}  // namespace palpate
