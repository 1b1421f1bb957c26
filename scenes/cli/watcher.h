/// A scene that changes under the hand.
#pragma once

#include <filesystem>
#include <future>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "palpate/engine/device.h"
#include "palpate/scenes/build_scene.h"
#include "palpate/scenes/scene_cache.h"

namespace palpate::cli {

/// When it was last written; nothing where it is not there.
[[nodiscard]] std::optional<std::filesystem::file_time_type> writtenAt(const std::string& file);

/// A coupling that all devices render: lowered where nobody has asked for it, else refused (throws
/// SceneError). True where it was lowered.
[[nodiscard]] bool fitToAll(SceneSpec& spec, const std::vector<const Device*>& devices);

/// A scene file that is made anew when it changes, on a thread of its own, so that keys and faults
/// are looked at meanwhile; what is wrong with it is said, and the scene that runs goes on.
class Watcher {
 public:
  /// `seen`: when the scene that runs was written.
  Watcher(std::string file, std::optional<std::filesystem::file_time_type> seen,
          std::vector<const Device*> devices, SceneCache& cache)
      : file_(std::move(file)), devices_(std::move(devices)), cache_(cache), seen_(seen) {}

  /// The new scene; none where there is none yet.
  std::optional<BuiltScene> look();

 private:
  std::string file_;
  std::vector<const Device*> devices_;
  SceneCache& cache_;
  std::optional<std::filesystem::file_time_type> seen_;
  std::future<BuiltScene> made_;
};

}  // namespace palpate::cli
