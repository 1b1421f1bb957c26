/// Finds the frames of sequences, which are files or grids of one file.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Returns true if a file name is a pattern for several files: it contains %d or %0Nd in place of a
/// number.
[[nodiscard]] bool isPattern(const std::filesystem::path& file);

/// Returns the load requests for the frames of a volume, in the order of the frames. For a pattern,
/// these are the files of its folder that match, by number. Otherwise they are the grids name[0],
/// name[1] and so on with the volume's grid name; without a grid name, all grids of the file.
/// Throws VolumeError if no file matches, if a number between two others is missing, or if the file
/// cannot be read.
[[nodiscard]] std::vector<VolumeRequest> framesOf(const VolumeSpec& volume);

/// Returns the files that a volume is read from. For a pattern, these are all files that match; for
/// bricks, it is the manifest. Returns an empty list if the volume is not read from files. Does not
/// throw.
[[nodiscard]] std::vector<std::filesystem::path> filesOf(const VolumeSpec& volume);

}  // namespace palpate
