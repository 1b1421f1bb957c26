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

/// A coupling that all devices render: lowered where nobody has asked for it, else refused (throws
/// SceneError). True where it was lowered.
[[nodiscard]] bool fitToAll(SceneSpec& spec, const std::vector<const Device*>& devices);

/// Multiplies the strength of each mode by a factor; by 0 it is next to nothing, so that the hand
/// feels a scene of the same modes. Modes without one are as they were.
void dial(SceneSpec& spec, const std::vector<double>& factors);

/// The factors of modes of one scene for another's, each by its mode's name; 1 for a new one.
[[nodiscard]] std::vector<double> renumbered(const std::vector<double>& factors,
                                             const SceneSpec& from, const SceneSpec& to);

/// A scene that is made anew when its file changes or its dials are turned, on a thread of its own,
/// so that keys and faults are looked at meanwhile; what is wrong with it is said, and the scene
/// that runs goes on.
class Watcher {
 public:
  /// `spec`: of the scene that runs, as its file has it, written at `seen`.
  /// `files`: whether the file is looked at.
  Watcher(SceneSpec spec, std::string file, std::optional<std::filesystem::file_time_type> seen,
          bool files, std::vector<const Device*> devices, SceneCache& cache)
      : spec_(std::move(spec)),
        file_(std::move(file)),
        files_(files),
        devices_(std::move(devices)),
        cache_(cache),
        seen_(seen) {}

  /// Turns the dials, as by dial(), with the next look.
  void turn(std::vector<double> factors) {
    factors_ = std::move(factors);
    turned_ = true;
  }
  /// The new scene; none where there is none yet.
  std::optional<BuiltScene> look();

 private:
  struct Made {
    SceneSpec spec;
    BuiltScene built;
    bool read = false;  ///< From the file, anew.
  };
  [[nodiscard]] bool changed();

  SceneSpec spec_;
  std::string file_;
  bool files_;
  std::vector<const Device*> devices_;
  SceneCache& cache_;
  std::optional<std::filesystem::file_time_type> seen_;
  std::vector<double> factors_;
  bool turned_ = false;
  std::future<Made> made_;
};

}  // namespace palpate::cli
