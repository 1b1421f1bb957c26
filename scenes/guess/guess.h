/// Scene guess: a first scene for volumes without a scene file. It serves plain .vdb files,
/// `palpate import --scene` and `palpate scene`.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Kind of the volumes as the user states it, regardless of what their values suggest.
enum class GuessFor : std::uint8_t { kAnything, kCt, kMri, kCfd, kFibres, kLabels };

/// A scene guess and its reasons.
struct Guess {
  std::string scene;              ///< JSON text, formatted for people.
  std::vector<std::string> seen;  ///< "density: ...", a line for each grid in the scene.
  std::vector<std::string> made;  ///< "skin: ...", a line for each mode.
  std::vector<std::string> left;  ///< "H2: ...", a line for each omission, with a remedy if any.
};

/// A loaded grid and its name.
struct GuessVolume {
  std::string grid;                      ///< Name from gridNames.
  std::shared_ptr<const Volume> volume;  ///< Not null.
};

/// Names for the scene.
struct GuessNames {
  std::string file;    ///< The .vdb, as the scene shall name it.
  std::string prefix;  ///< For volumes, fields and modes; "a." if there are other files too.
  std::string like;    ///< A volume of another file that all are placed like; may be empty.
};

/// Returns a first scene for the grids of a file. Analyses a bounded number of voxels per grid. The
/// result is the same for the same grids and any number of threads. Throws VolumeError if no grid
/// varies.
[[nodiscard]] Guess guessScene(const GuessNames& names, const std::vector<GuessVolume>& volumes,
                               GuessFor what = GuessFor::kAnything);

}  // namespace palpate
