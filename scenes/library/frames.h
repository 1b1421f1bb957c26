/// Finds the frames of a sequence: files, or grids of one file.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Returns true for a pattern that stands for several files: its name has %d or %0Nd (N: one digit)
/// in the place of a number, and no other %.
[[nodiscard]] bool isPattern(const std::filesystem::path& file);

/// Returns the load requests for the frames of a volume, in order. For a pattern, these are the
/// files in its folder that match, by number. Otherwise they are the grids name[0], name[1] and so
/// on, or the grid `name`. If the volume names no grid, they are all grids of the file. Throws
/// VolumeError if no file matches, if the numbers have a gap, or if the file cannot be read. Also
/// throws if the volume names no grid and the file has grids of several names.
[[nodiscard]] std::vector<VolumeRequest> framesOf(const VolumeSpec& volume);

/// Returns the local files of a volume: its file, all files that match its pattern, or the manifest
/// of its bricks. Empty for an address and for a volume without a file. Does not throw.
[[nodiscard]] std::vector<std::filesystem::path> filesOf(const VolumeSpec& volume);

}  // namespace palpate
