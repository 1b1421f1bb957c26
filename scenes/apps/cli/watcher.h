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

/// Lowers the coupling's stiffness to the limits of all devices, unless the user has set it.
/// Returns true if it was lowered. Throws SceneError if a device cannot render the coupling.
[[nodiscard]] bool fitToAll(SceneSpec& spec, const std::vector<const Device*>& devices);

/// Rebuilds a scene on its own thread if its file, its gains or a volume's image changes, or if
/// another site edits it. If the new scene has errors, reports them and keeps the present scene.
class Watcher {
 public:
  /// @param spec   Present scene as in its file, fitted to `devices`.
  /// @param seen   Time at which the file was last written.
  /// @param files  If true, rebuilds the scene when the file changes.
  Watcher(SceneSpec spec, std::string file, std::optional<std::filesystem::file_time_type> seen,
          bool files, std::vector<const Device*> devices, SceneCache& cache)
      : spec_(std::move(spec)),
        ids_(idsOf(spec_)),
        file_(std::move(file)),
        files_(files),
        devices_(std::move(devices)),
        cache_(cache),
        seen_(seen) {}

  /// Changes gains at the next look(). Ignores missing modes. `request` is LiveWishes::dialled.
  void turn(const std::vector<LiveDial>& dials, std::uint64_t request);
  /// Returns true if the watcher can take the next image.
  [[nodiscard]] bool takesImage() const noexcept { return image_ == nullptr && !made_.valid(); }
  /// Starts the exchange of edits. `site` is this site; `file` and `text` are of the present scene.
  void share(const std::string& site, const std::string& file, const std::string& text) {
    shared_.emplace(site, text);
    source_ = file;
  }
  /// Merges the scene text of another site, and prints messages. Call share() before.
  void hear(const std::string& site, const std::string& text);
  /// Returns the text of the scene for other sites, once after each change; otherwise no value.
  [[nodiscard]] std::optional<std::string> takeTold() {
    return shared_ ? shared_->takeTold() : std::nullopt;
  }
  /// From the next look() on, the image replaces the volume of its name, in later scenes too.
  void replace(std::shared_ptr<const IgtlImage> image) { image_ = std::move(image); }
  /// Returns the result of the last image, once; otherwise an empty text.
  [[nodiscard]] std::string takeNews() { return std::exchange(news_, {}); }
  /// Returns a new scene once it is built; otherwise no value. Starts to build after a change.
  std::optional<BuiltScene> look();
  [[nodiscard]] std::vector<LiveDial> dials() const { return inOrder(felt_, ids_); }
  /// Returns the latest scene, to which no gains are applied.
  [[nodiscard]] const SceneSpec& spec() const noexcept { return spec_; }
  /// Returns the latest scene's text with edits of other sites; empty for the run's first scene.
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
    /// Rejected edits of other sites, with reasons; one line each.
    std::vector<std::string> refused;
    bool same = false;
  };
  /// Input for the thread that builds a scene.
  struct Task {
    bool read;    ///< The file must be read again.
    bool edited;  ///< Edits of other sites must be taken over.
    bool still;   ///< The gains have not changed.
    Dials dials;
    std::optional<SharedScene> shared;
    std::shared_ptr<const IgtlImage> image;
  };
  /// Least time between two edits of other sites: an engagement must end before the next edit.
  static constexpr auto kBetweenEdits = std::chrono::seconds(2);

  [[nodiscard]] bool changed();
  /// Starts a build if the file, an edit, the image or the gains have changed.
  void startBuild();
  /// Returns a built scene that has changed. Reports a failed build.
  [[nodiscard]] std::optional<BuiltScene> takeBuilt();
  /// Makes a built scene the present scene and returns it, unless it is unchanged. `image`
  /// may be null.
  [[nodiscard]] std::optional<BuiltScene> adopt(Made made, const IgtlImage* image);
  /// Runs on the building thread.
  [[nodiscard]] Made make(const Task& task) const;
  /// Builds `spec` with the gains and the images. If it throws, `made` remains unchanged.
  void build(Made& made, SceneSpec spec, const Dials& dials) const;
  /// Builds with as many valid edits of other sites as possible. `read`, `still`: as in Task.
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
  std::string source_;  ///< The scene file. Differs from `file_` if `file_` is a recording.
  std::set<std::string> refused_edits_;
  std::chrono::steady_clock::time_point next_edits_;
  std::map<std::string, std::shared_ptr<const Volume>> replaced_;  ///< Volumes from images.
  std::shared_ptr<const IgtlImage> image_;  ///< Image to take over next, or being taken over.
  bool making_image_ = false;
  std::string news_;
  std::future<Made> made_;
};

}  // namespace palpate::cli
