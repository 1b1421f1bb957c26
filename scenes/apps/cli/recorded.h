/// Stores scenes in recordings, and restores them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/devices/recording/recording.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/live.h"

namespace palpate::cli {

/// A scene to run, and the data that a recording keeps of it.
struct SceneInput {
  SceneSpec spec;
  std::string file;  ///< File of the scene.
  std::string text;  ///< Content of the file; empty for a .vdb, or a folder.
  std::vector<std::filesystem::path>
      files;  ///< All files of the scene; for a recording, of all its scenes.
};
/// Opens a scene (openScene), or the first scene that was felt in a recording. Reports files of a
/// recording that have changed. Throws Error.
[[nodiscard]] SceneInput openSceneInput(const std::string& scene);

/// Opens a scene's file and returns it with its text. The text belongs to the scene even if the
/// file is written in the meantime. Throws Error.
[[nodiscard]] SceneInput openWithText(const std::string& file, const Progress& progress);

/// Returns a scene as a recording keeps it (JSON): its file, its text and its modes' gains. For
/// each volume's file it has the size and the checksum; for remote bricks, their identity. Reads
/// local files once, and no remote data. `windows`: those of the built scene.
[[nodiscard]] std::string recordedScene(const std::string& file, const std::string& text,
                                        const SceneSpec& spec, const std::vector<LiveDial>& dials,
                                        const Windows& windows);

/// Returns the scene with this id in a recording. Unset if it is not in the recording, if the scene
/// or its volumes have changed on disk, or if gains were changed. Throws Error.
[[nodiscard]] std::optional<SceneInput> sceneAsItIs(const Recording& recording, std::uint64_t id);

/// A scene, and the text that a recording keeps of it.
struct SceneAgain {
  std::shared_ptr<const Scene> scene;
  std::string text;
};
/// Scenes by their ids in a recording's ticks.
using ScenesById = std::map<std::uint64_t, SceneAgain>;
/// Returns all scenes of a recording, fitted to its device; `first` is the first one, already
/// built. Throws Error.
[[nodiscard]] ScenesById scenesOf(const Recording& recording, std::shared_ptr<const Scene> first,
                                  SceneCache& cache);

}  // namespace palpate::cli
