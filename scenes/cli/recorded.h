/// Scenes in recordings: what they were made of, and the same again.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "palpate/devices/recording.h"
#include "palpate/scenes/build_scene.h"
#include "palpate/scenes/live.h"

namespace palpate::cli {

/// A scene that is to be felt, and what a recording keeps of it.
struct ToFeel {
  SceneSpec spec;
  std::string file;  ///< Of the scene.
  std::string text;  ///< As it was read; empty for a .vdb, or a folder.
  std::vector<std::filesystem::path>
      files;  ///< All that it is made of, of a recording all scenes'.
};
/// Opens a scene (openScene), or the first that was felt of a recording; says which of a
/// recording's files are not what they were. Throws Error.
[[nodiscard]] ToFeel sceneToFeel(const std::string& scene);

/// Opens a scene's file, and gives the text that it was made of with it: what is felt is what is
/// recorded, although somebody writes it meanwhile. Throws Error.
[[nodiscard]] ToFeel openWithText(const std::string& file, const Progress& progress);

/// A scene as a recording keeps it (JSON): its file, its text, how its modes' dials were turned,
/// and of each volume's file the size and the checksum, of bricks elsewhere their identity. Reads
/// those files once, and nothing that is elsewhere. `windows`: of the scene that was built of it.
[[nodiscard]] std::string recordedScene(const std::string& file, const std::string& text,
                                        const SceneSpec& spec, const std::vector<LiveDial>& dials,
                                        const Windows& windows);

/// The scene of that id in a recording, where it and its volumes are still the files that they
/// were; none where they are not, where dials were turned, or where it is not in it. Throws Error.
[[nodiscard]] std::optional<ToFeel> sceneAsItIs(const Recording& recording, std::uint64_t id);

/// A scene, and what a recording keeps of it.
struct SceneAgain {
  std::shared_ptr<const Scene> scene;
  std::string text;
};
/// Scenes by the ids that a recording's ticks have.
using ScenesById = std::map<std::uint64_t, SceneAgain>;
/// All scenes of a recording, fitted to the device that it is of; the first is `first`, built
/// already. Throws Error.
[[nodiscard]] ScenesById scenesOf(const Recording& recording, std::shared_ptr<const Scene> first,
                                  SceneCache& cache);

}  // namespace palpate::cli
