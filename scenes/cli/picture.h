/// The picture of a run: the path over the volumes' slices and the force over time.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/engine/telemetry.h"
#include "palpate/scenes/build_scene.h"
#include "palpate/scenes/cli/common.h"
#include "palpate/scenes/cli/felt.h"
#include "palpate/scenes/cli/script.h"

namespace palpate::cli {

/// The path, which says what it will be; throws Error where it does not.
[[nodiscard]] const std::string& pngName(const std::string& path);
/// The same of a picture for print: "png", "pdf" or "svg".
[[nodiscard]] std::string formatOf(const std::string& path);

/// Collects a run and has feel_picture.py (matplotlib) draw it.
class Picture {
 public:
  /// Throws Error at once if the place cannot be written, its ending says no format or matplotlib
  /// is missing.
  explicit Picture(const std::string& path);
  void add(const Telemetry& tick);
  /// Throws Error; no partial file is left.
  void draw(const SceneSpec& spec, const BuiltScene& built, const Felt& felt);

 private:
  std::filesystem::path path_;
  std::string format_;
  WholeFile file_;
  Script script_;
  std::vector<Telemetry> ticks_;  ///< Every stride_-th.
  std::size_t stride_ = 1;
  std::size_t seen_ = 0;
};

}  // namespace palpate::cli
