/// Scene files (JSON), and guessed scenes for plain .vdb files.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/scenes/guess/guess.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Reads a scene file and checks it against the project's JSON Schema. Relative paths start at its
/// folder. If `text` is not null, it receives the file's text. Throws SceneError.
[[nodiscard]] SceneSpec readSceneFile(const std::filesystem::path& file,
                                      std::string* text = nullptr);

/// Like readSceneFile, from text. Errors name `source`; relative paths start at `folder`.
[[nodiscard]] SceneSpec parseScene(const std::string& text, const std::string& source,
                                   const std::filesystem::path& folder);

/// Returns the scene guess (guess.h) for a .vdb file, or for each .vdb of a folder. The first
/// volume fits into 0.1 m at the workspace's centre; the others are placed like it.
/// SceneSpec::notes names unusable grids and items that the guess left out. Throws VolumeError if
/// no usable grid remains.
[[nodiscard]] SceneSpec sceneFromVdb(const std::filesystem::path& path,
                                     const Progress& progress = nullptr);

/// Returns the same guess for one file as text, with its reasons. The text names the path as given.
[[nodiscard]] Guess guessVdb(const std::filesystem::path& file, GuessFor what = GuessFor::kAnything,
                             const Progress& progress = nullptr);

/// Opens any of the above, depending on the path. If `text` is not null, it receives the text of a
/// scene file; it is empty for volumes.
[[nodiscard]] SceneSpec openScene(const std::filesystem::path& path,
                                  const Progress& progress = nullptr, std::string* text = nullptr);

/// Returns the JSON Schema of scene files.
[[nodiscard]] const std::string& sceneSchema();

}  // namespace palpate
