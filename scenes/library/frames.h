/// Frames of sequences: files, or grids of one file.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Returns true if a file name stands for many files: it has one %d or %0Nd for their number.
[[nodiscard]] bool isPattern(const std::filesystem::path& file);

/// Returns the load requests for the frames of a volume, in order. For a pattern, these are the
/// matching files of its folder, by number. Otherwise they are the grids with the volume's name:
/// name[0], name[1] and so on; if it names no grid, all grids of the file. Throws VolumeError if no
/// file matches, a number is missing between two others, or the file cannot be read.
[[nodiscard]] std::vector<VolumeRequest> framesOf(const VolumeSpec& volume);

/// Returns the files that a volume is read from: for a pattern all existing files, for bricks the
/// manifest. Returns an empty list if the volume is not read from files. Does not throw.
[[nodiscard]] std::vector<std::filesystem::path> filesOf(const VolumeSpec& volume);

}  // namespace palpate
