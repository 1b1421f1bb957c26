/// Reads scene files (JSON), and guesses scenes for .vdb files.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/scenes/guess/guess.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Reads a scene file and checks it against the JSON Schema of scene files. Relative paths start at
/// the file's folder. If `text` is not null, it receives the file's text. Throws SceneError.
[[nodiscard]] SceneSpec readSceneFile(const std::filesystem::path& file,
                                      std::string* text = nullptr);

/// Reads a scene from text as readSceneFile() does. Errors name `source`. Relative paths start at
/// `folder`.
[[nodiscard]] SceneSpec parseScene(const std::string& text, const std::string& source,
                                   const std::filesystem::path& folder);

/// Returns the scene guess (guess.h) for a .vdb file, or for all .vdb files of a folder. The first
/// volume is scaled to 0.1 m and centred; the others are placed like the first volume.
/// SceneSpec::notes names unusable grids and omissions. Throws VolumeError if no grid is usable.
[[nodiscard]] SceneSpec sceneFromVdb(const std::filesystem::path& path,
                                     const Progress& progress = nullptr);

/// Returns the scene guess for a .vdb file or a folder of bricks, with its reasons. The JSON
/// contains the path as given.
[[nodiscard]] Guess guessVdb(const std::filesystem::path& file, GuessFor what = GuessFor::kAnything,
                             const Progress& progress = nullptr);

/// Opens a scene file, or guesses a scene for volumes. If `text` is not null, it receives the text
/// of the scene file; for volumes it becomes empty.
[[nodiscard]] SceneSpec openScene(const std::filesystem::path& path,
                                  const Progress& progress = nullptr, std::string* text = nullptr);

/// Returns the JSON Schema of scene files as text.
[[nodiscard]] const std::string& sceneSchema();

}  // namespace palpate
