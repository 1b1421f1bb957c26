/// Draws the picture of a run: the path over the volumes' slices, and the force over time or over
/// the depth of a press.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "palpate/engine/loop/telemetry.h"
#include "palpate/scenes/apps/cli/felt.h"
#include "palpate/scenes/apps/cli/script.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate::cli {

/// Returns `path` if it ends in .png. Otherwise throws Error.
[[nodiscard]] const std::string& pngName(const std::string& path);
/// Returns "png", "pdf" or "svg", as `path` ends. Throws Error for another ending.
[[nodiscard]] std::string formatOf(const std::string& path);

struct PictureOptions {
  std::string file;                  ///< Empty: no picture.
  std::optional<std::string> title;  ///< Unset: the scene's name, and where the slices meet.
  /// "x,y,z", where the slices meet, in the picture's coordinates; empty: the place of the largest
  /// force (Felt::most) or, without a force, the middle.
  std::string slices;
};
/// Adds --picture, with this description, and the options that apply only to it.
void addPictureOptions(CLI::App& verb, PictureOptions& options, const std::string& description);
/// Throws Error if an option is invalid, or has no effect without --picture.
void checkPicture(const PictureOptions& options);

/// Collects the ticks of a run for its picture, which feel_picture.py (matplotlib) draws.
class Picture {
 public:
  /// Throws Error if the file cannot be written, its ending is unknown, or matplotlib is missing.
  explicit Picture(const PictureOptions& options);
  void add(const Telemetry& tick);
  /// Draws the picture. Throws Error, and Interrupted after an interrupt. If draw() throws, the
  /// file stays as it was.
  /// @param press  Null, or the curve of a press, which replaces the force over time: "in" and
  ///   "out" are rows of depth [m] and force [N], "marks" are events with a name and a depth.
  void draw(const SceneSpec& spec, const BuiltScene& built, const Felt& felt,
            const OrderedJson& press = nullptr);

 private:
  PictureOptions options_;
  std::filesystem::path path_;
  std::string format_;
  WholeFile file_;
  Script script_;
  std::vector<Telemetry> ticks_;  ///< Every stride_-th tick.
  std::size_t stride_ = 1;
  std::size_t seen_ = 0;
};

}  // namespace palpate::cli
