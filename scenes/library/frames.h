/// Finds the frames of sequences, which are files or grids of one file.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Returns true for a pattern of several files, with %d or %0Nd in place of a number.
[[nodiscard]] bool isPattern(const std::filesystem::path& file);

/// Returns the load requests for the frames of a volume, in order. For a pattern, these are the
/// matching files of its folder, by number. Otherwise they are the grids name[0], name[1] and so
/// on; if the volume names no grid, all grids of the file. Throws VolumeError if no file matches,
/// if a number between two others is missing, or if the file cannot be read.
[[nodiscard]] std::vector<VolumeRequest> framesOf(const VolumeSpec& volume);

/// Returns the files from which a volume is read: all matches of a pattern, or the manifest of
/// bricks; may be empty. Does not throw.
[[nodiscard]] std::vector<std::filesystem::path> filesOf(const VolumeSpec& volume);

}  // namespace palpate
