/// Stores scenes in recordings, and restores scenes from recordings.
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

/// A scene to run, with the text and the files that define it.
struct SceneInput {
  SceneSpec spec;
  std::string file;  ///< Path of the scene file.
  std::string text;  ///< Content of the scene file; empty for a .vdb or a folder.
  std::vector<std::filesystem::path>
      files;  ///< All files that the scene reads; for a recording, those of all its scenes.
};
/// Opens `scene` as openScene does. If `scene` is a recording, restores the scene of its first tick
/// and reports files that have changed since the recording. Throws Error.
[[nodiscard]] SceneInput openSceneInput(const std::string& scene);

/// Opens a scene file and returns the scene with the text that it was parsed from, even if another
/// program writes the file in the meantime. Throws Error.
[[nodiscard]] SceneInput openWithText(const std::string& file, const Progress& progress);

/// Returns the JSON with which a recording stores a scene: its file, its text and the gains of its
/// modes. Each local volume file is stored by its size and checksum, remote bricks by their
/// identity. Reads local files once, and no remote data. `windows` are the brick windows of the
/// built scene.
[[nodiscard]] std::string recordedScene(const std::string& file, const std::string& text,
                                        const SceneSpec& spec, const std::vector<LiveDial>& dials,
                                        const Windows& windows);

/// Returns the scene with this id from a recording. Returns no value if the recording lacks the
/// scene, if the scene file or a volume has changed on disk, or if gains were changed. Throws
/// Error.
[[nodiscard]] std::optional<SceneInput> sceneAsItIs(const Recording& recording, std::uint64_t id);

/// A built scene with the JSON that a recording stores of it (recordedScene).
struct SceneAgain {
  std::shared_ptr<const Scene> scene;
  std::string text;
};
/// Scenes, by the ids that the ticks of a recording have for them.
using ScenesById = std::map<std::uint64_t, SceneAgain>;
/// Builds all scenes of a recording and fits their couplings to the recorded device. `first` is the
/// scene of the first tick, which is already built. Throws Error.
[[nodiscard]] ScenesById scenesOf(const Recording& recording, std::shared_ptr<const Scene> first,
                                  SceneCache& cache);

}  // namespace palpate::cli
