/// Guesses a first scene for volumes without a scene file.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Kind of the volumes, as the user states it with --for. It has priority over most rules that use
/// the metadata or the values (kind_rules.cpp).
enum class GuessFor : std::uint8_t { kAnything, kCt, kMri, kCfd, kFibres, kLabels };

/// A guessed scene and the reasons for it.
struct Guess {
  std::string scene;  ///< JSON text with line breaks and indentation.
  /// For each grid in the scene, a line with its kind and the reason: "density: ...".
  std::vector<std::string> seen;
  /// For each mode, a line with the reason for it: "skin: ...".
  std::vector<std::string> made;
  /// For each omitted grid, a line with the reason and a possible remedy: "H2: ...".
  std::vector<std::string> left;
};

/// A grid in memory, and its name.
struct GuessVolume {
  std::string grid;                      ///< Name of the grid, as gridNames returns it.
  std::shared_ptr<const Volume> volume;  ///< Not null.
  bool bricks = false;                   ///< True if the volume is in bricks.
};

/// Names that the scene uses.
struct GuessNames {
  std::string file;  ///< Path of the .vdb or of the bricks in the scene.
  /// Prefix for the names of volumes, fields and modes, such as "a."; empty for a single file.
  std::string prefix;
  std::string like;  ///< Volume of another file, whose place all volumes get; "": no such volume.
};

/// Returns a first scene for the grids of a file, from their metadata and a sample of their voxels.
/// The result does not depend on the number of threads. Throws VolumeError if no grid is usable,
/// for example if all are constant scalars.
[[nodiscard]] Guess guessScene(const GuessNames& names, const std::vector<GuessVolume>& volumes,
                               GuessFor what = GuessFor::kAnything);

}  // namespace palpate
