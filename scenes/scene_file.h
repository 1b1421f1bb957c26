/// Scene files (JSON), and scenes made up for bare .vdb files.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/scenes/build_scene.h"
#include "palpate/scenes/guess.h"

namespace palpate {

/// Reads a scene file: syntax, then every key and value by path, then the JSON Schema that ships
/// with the project. Relative paths start at the file. Throws SceneError.
[[nodiscard]] SceneSpec readSceneFile(const std::filesystem::path& file,
                                      std::string* text = nullptr);

/// As readSceneFile, from text; `source` is named in errors, relative paths start at `folder`.
[[nodiscard]] SceneSpec parseScene(const std::string& text, const std::string& source,
                                   const std::filesystem::path& folder);

/// The guess (guess.h) at a .vdb file, or at each of a folder's. The first volume fits into 0.1 m
/// at the workspace's centre, the rest are placed like it. Grids that cannot be felt, and what the
/// guess left out, are named in SceneSpec::notes; throws VolumeError when none is left.
[[nodiscard]] SceneSpec sceneFromVdb(const std::filesystem::path& path,
                                     const Progress& progress = nullptr);

/// The same guess at one file, as text, with its reasons; its path is named as it is given.
[[nodiscard]] Guess guessVdb(const std::filesystem::path& file, GuessFor what = GuessFor::kAnything,
                             const Progress& progress = nullptr);

/// Any of the above, by what the path is. `text`: where not null, what was read of a scene file;
/// empty for volumes.
[[nodiscard]] SceneSpec openScene(const std::filesystem::path& path,
                                  const Progress& progress = nullptr, std::string* text = nullptr);

/// The JSON Schema of scene files.
[[nodiscard]] const std::string& sceneSchema();

}  // namespace palpate
