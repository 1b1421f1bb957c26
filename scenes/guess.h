/// A first scene for volumes that nobody has described: the guess that a bare .vdb is felt by, that
/// `palpate import --scene` and `palpate scene` write.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "palpate/samplers/volume.h"

namespace palpate {

/// What a user says that the volumes are, whatever they look like.
enum class GuessFor : std::uint8_t { kAnything, kCt, kMri, kCfd, kFibres, kLabels };

/// A guess and its reasons.
struct Guess {
  std::string scene;              ///< JSON, as a person would write it.
  std::vector<std::string> seen;  ///< "density: ...", a line a grid that is felt.
  std::vector<std::string> made;  ///< "skin: ...", a line a mode.
  std::vector<std::string> left;  ///< "H2: ...", a line for what is left out, with a remedy if any.
};

/// A loaded grid, and how a scene names it.
struct GuessVolume {
  std::string grid;                      ///< As gridNames has it.
  std::shared_ptr<const Volume> volume;  ///< Not null.
};

/// How the scene names things.
struct GuessNames {
  std::string file;    ///< The .vdb, as the scene shall say it.
  std::string prefix;  ///< Of volumes, fields and modes; "a." where there are other files' as well.
  std::string like;    ///< A volume of another file that all are placed like; empty: none.
};

/// A first scene for the grids of a file. Looks at a bounded number of voxels a grid; the same for
/// the same grids, whatever the threads. Throws VolumeError where nothing varies.
[[nodiscard]] Guess guessScene(const GuessNames& names, const std::vector<GuessVolume>& volumes,
                               GuessFor what = GuessFor::kAnything);

}  // namespace palpate
