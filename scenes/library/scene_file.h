/// Reads scene files (JSON), and guesses scenes for .vdb files.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/scenes/guess/guess.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Reads a scene file and checks it against the JSON Schema of scene files. Relative paths start at
/// the file's folder. If `text` is not null, it receives the file's text. Throws SceneError, or
/// VolumeError for a file that is neither JSON nor a .vdb.
[[nodiscard]] SceneSpec readSceneFile(const std::filesystem::path& file,
                                      std::string* text = nullptr);

/// Reads a scene from text as readSceneFile() does. Errors name `source`. Relative paths start at
/// `folder`. Throws SceneError.
[[nodiscard]] SceneSpec parseScene(const std::string& text, const std::string& source,
                                   const std::filesystem::path& folder);

/// Returns the scene guess (guess.h) for a .vdb file, or for all .vdb files of a folder. The first
/// volume is scaled to 0.1 m and centred; the others are placed like the first volume.
/// SceneSpec::notes names unusable grids and omissions. Throws VolumeError if no grid is usable.
[[nodiscard]] SceneSpec sceneFromVdb(const std::filesystem::path& path,
                                     const Progress& progress = nullptr);

/// Returns the scene guess for a .vdb file, or for bricks in a folder or at an address, with its
/// reasons. The JSON contains the path as given, without a slash at its end. Throws SceneError for
/// a path of another kind, and VolumeError if no grid is usable.
[[nodiscard]] Guess guessVdb(const std::filesystem::path& file, GuessFor what = GuessFor::kAnything,
                             const Progress& progress = nullptr);

/// Opens a scene file, or guesses a scene for volumes. If `text` is not null, it receives the text
/// of the scene file; for volumes it becomes empty. Throws SceneError or VolumeError.
[[nodiscard]] SceneSpec openScene(const std::filesystem::path& path,
                                  const Progress& progress = nullptr, std::string* text = nullptr);

/// Returns the JSON Schema of scene files as text.
[[nodiscard]] const std::string& sceneSchema();

}  // namespace palpate
