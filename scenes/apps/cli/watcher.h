/// Rebuilds the scene of a run when its file, gains or images change.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <future>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "palpate/engine/safety/device.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/scenes/apps/cli/dials.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/scene_cache.h"
#include "palpate/scenes/network/sites/shared_scene.h"
#include "palpate/scenes/network/slicer/igtl_message.h"

namespace palpate::cli {

/// Lowers the coupling's stiffness to the lowest limit of the devices, unless the user has set the
/// stiffness. If it lowers the stiffness, prints a note and returns true. Throws SceneError if a
/// device cannot render the coupling.
[[nodiscard]] bool fitToAll(SceneSpec& spec, const std::vector<const Device*>& devices);

/// Rebuilds a scene on its own thread when its file, its gains or a volume's image changes, or when
/// another site edits it. If the new scene has errors, prints the errors and keeps the present
/// scene.
class Watcher {
 public:
  /// @param spec   Present scene as in the file, fitted to `devices`.
  /// @param seen   Time at which the file was last written.
  /// @param files  If true, watches the scene file for changes.
  Watcher(SceneSpec spec, std::string file, std::optional<std::filesystem::file_time_type> seen,
          bool files, std::vector<const Device*> devices, SceneCache& cache)
      : spec_(std::move(spec)),
        ids_(idsOf(spec_)),
        file_(std::move(file)),
        files_(files),
        devices_(std::move(devices)),
        cache_(cache),
        seen_(seen) {}

  /// Changes gains at the next look(). Ignores unknown modes. `request` is LiveWishes::dialled.
  void turn(const std::vector<LiveDial>& dials, std::uint64_t request);
  /// Returns true if the watcher can take the next image.
  [[nodiscard]] bool takesImage() const noexcept { return image_ == nullptr && !made_.valid(); }
  /// Starts the exchange of edits. `site` is this site. `file` and `text` are the present scene's.
  void share(const std::string& site, const std::string& file, const std::string& text) {
    shared_.emplace(site, text);
    source_ = file;
  }
  /// Merges the scene text of another site, and prints messages. Call share() first.
  void hear(const std::string& site, const std::string& text);
  /// Returns the scene's text for other sites, once after each change; otherwise no value.
  [[nodiscard]] std::optional<std::string> takeTold() {
    return shared_ ? shared_->takeTold() : std::nullopt;
  }
  /// From the next look() on, `image` replaces the volume with its name, in later scenes too.
  void replace(std::shared_ptr<const IgtlImage> image) { image_ = std::move(image); }
  /// Result of an image.
  struct ImageNews {
    std::string text;      ///< Empty: no result.
    bool refused = false;  ///< True if the previous volume remains.
  };
  /// Returns the result of the last image, once; otherwise an empty text.
  [[nodiscard]] ImageNews takeNews() { return std::exchange(news_, {}); }
  /// Starts a build after a change. Returns the new scene once it is built; otherwise no value.
  std::optional<BuiltScene> look();
  [[nodiscard]] std::vector<LiveDial> dials() const { return inOrder(felt_, ids_); }
  /// Returns the latest scene, before gains are applied.
  [[nodiscard]] const SceneSpec& spec() const noexcept { return spec_; }
  /// Returns the latest scene's text with edits of other sites; empty before the first change.
  [[nodiscard]] const std::string& text() const noexcept { return text_; }
  /// Returns the last rejected request for gains (LiveWishes::dialled).
  [[nodiscard]] std::uint64_t refused() const noexcept { return refused_; }

 private:
  struct Made {
    SceneSpec spec;
    ModeIds ids;
    BuiltScene built;
    std::string text;
    std::map<std::string, std::shared_ptr<const Volume>> replaced;
    std::optional<SharedScene> shared;
    /// Rejected edits of other sites with their reasons, one line each.
    std::vector<std::string> refused;
    bool same = false;
  };
  /// Input for the thread that builds a scene.
  struct Task {
    bool read;    ///< The file must be read again.
    bool edited;  ///< Edits of other sites must be applied.
    bool still;   ///< The gains have not changed.
    Dials dials;
    std::optional<SharedScene> shared;
    std::shared_ptr<const IgtlImage> image;
  };
  /// Least time between two edits of other sites, so that the force can engage again between them.
  static constexpr auto kBetweenEdits = std::chrono::seconds(2);

  [[nodiscard]] bool changed();
  /// Starts a build if the file, an edit, the image or the gains have changed.
  void startBuild();
  /// Returns a built scene that differs from the present one. Reports a failed build.
  [[nodiscard]] std::optional<BuiltScene> takeBuilt();
  /// Makes a built scene the present scene, and returns that scene unless the build changed
  /// nothing. `image` may be null.
  [[nodiscard]] std::optional<BuiltScene> adopt(Made made, const IgtlImage* image);
  /// Builds a scene. Runs on the building thread.
  [[nodiscard]] Made make(const Task& task) const;
  /// Builds `spec` with gains and images. If build() throws, `made` is unchanged.
  void build(Made& made, SceneSpec spec, const Dials& dials) const;
  /// Builds the scene with the valid edits of other sites. `read`, `still`: as in Task.
  void buildShared(Made& made, bool read, bool still, const Dials& dials) const;
  void tellOfEdits(const Made& made);

  SceneSpec spec_;
  ModeIds ids_;
  std::string file_;
  std::string text_;
  bool files_;
  std::vector<const Device*> devices_;
  SceneCache& cache_;
  std::optional<std::filesystem::file_time_type> seen_;
  Dials wanted_;
  Dials tried_;
  Dials felt_;
  std::uint64_t request_ = 0;  ///< LiveWishes::dialled of wanted_.
  std::uint64_t trying_ = 0;   ///< LiveWishes::dialled of tried_.
  std::uint64_t refused_ = 0;
  bool read_ = false;
  bool edited_ = false;
  std::optional<SharedScene> shared_;
  std::string source_;  ///< The scene file, also if `file_` is its recording.
  std::set<std::string> refused_edits_;
  std::chrono::steady_clock::time_point next_edits_;
  std::map<std::string, std::shared_ptr<const Volume>> replaced_;  ///< Volumes from images.
  std::shared_ptr<const IgtlImage> image_;  ///< Image for the present or the next build.
  bool making_image_ = false;
  ImageNews news_;
  std::future<Made> made_;
};

}  // namespace palpate::cli
