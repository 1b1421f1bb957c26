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

struct SceneInput {
  SceneSpec spec;
  std::string file;
  std::string text;  ///< Content of the scene file; empty for a .vdb or a folder.
  std::vector<std::filesystem::path> files;  ///< For a recording: files of all its scenes.
};
/// Opens a scene as openScene does. For a recording, restores the scene of its first tick with a
/// scene (if there is no such tick, the first scene), and reports files that have changed since the
/// recording. Throws Error.
[[nodiscard]] SceneInput openSceneInput(const std::string& scene);

/// Opens a scene, and returns the scene with its source text. Throws Error.
[[nodiscard]] SceneInput openWithText(const std::string& file, const Progress& progress);

/// Returns the JSON by which a recording stores a scene: with the sizes and checksums of local
/// files and the identities of remote bricks. Reads each local file once, and no remote data.
[[nodiscard]] std::string recordedScene(const std::string& file, const std::string& text,
                                        const SceneSpec& spec, const std::vector<LiveDial>& dials,
                                        const Windows& windows);

/// Throws Error if the file is a recording, for verbs that read volumes.
void refuseRecording(const std::string& file);

/// Returns the scene with this id. Returns no value if the scene is missing, if the scene file or
/// its volumes have changed, or if gains were recorded with the scene. Throws Error.
[[nodiscard]] std::optional<SceneInput> sceneAsItIs(const Recording& recording, std::uint64_t id);

struct SceneAgain {
  std::shared_ptr<const Scene> scene;
  std::string text;
};
/// Returns Telemetry::scene of a recording's first tick with a scene; 0 if each tick lacks a scene.
[[nodiscard]] std::uint64_t firstScene(const Recording& recording);

/// Scenes by the ids in a recording's ticks.
using ScenesById = std::map<std::uint64_t, SceneAgain>;
/// Builds all scenes of a recording for the recorded device, except the scene that openSceneInput()
/// restores: `first` is this scene, already built. Throws Error.
[[nodiscard]] ScenesById scenesOf(const Recording& recording, std::shared_ptr<const Scene> first,
                                  SceneCache& cache);

}  // namespace palpate::cli
