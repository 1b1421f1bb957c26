/// Volumes that are sequences: their frames, by files or by grids of one file.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/scenes/build_scene.h"

namespace palpate {

/// True where a file's name stands for many: it has one %d or %0Nd for their number.
[[nodiscard]] bool isPattern(const std::filesystem::path& file);

/// The frames of a volume in their order, as they are to be loaded. A pattern: the files of its
/// folder that it names, by number. Else the grids of the file that have the volume's name,
/// name[0], name[1] and so on; with no grid named, all of the file. Throws VolumeError: none is
/// there, a number is left out between two, or the file cannot be read.
[[nodiscard]] std::vector<VolumeRequest> framesOf(const VolumeSpec& volume);

/// The files that a volume is read from: of a pattern all that are there, of bricks the manifest.
/// Empty where it is read
/// from none. Throws nothing.
[[nodiscard]] std::vector<std::filesystem::path> filesOf(const VolumeSpec& volume);

}  // namespace palpate
