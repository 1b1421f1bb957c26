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

/// Lowers the stiffness of the coupling to the limits of all devices, unless the user has set the
/// stiffness. Returns true if it was lowered. Throws SceneError if a device still cannot render the
/// coupling.
[[nodiscard]] bool fitToAll(SceneSpec& spec, const std::vector<const Device*>& devices);

/// Rebuilds a scene if its file, its gains or the image of a volume changes, or if another site
/// edits the scene. A separate thread builds the scene, so that the main thread can handle keys and
/// faults. If the new scene has errors, reports them and keeps the present scene.
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

  /// Changes gains at the next look(). Ignores gains of modes that the scene does not have by then.
  /// `request` is LiveWishes::dialled.
  void turn(const std::vector<LiveDial>& dials, std::uint64_t request);
  /// Returns true if the watcher can take an image: it has finished with the previous image.
  [[nodiscard]] bool takesImage() const noexcept { return image_ == nullptr && !made_.valid(); }
  /// Starts the exchange of edits with other sites. `site` is the name of this site; `file` and
  /// `text` belong to the present scene (SceneInput).
  void share(const std::string& site, const std::string& file, const std::string& text) {
    shared_.emplace(site, text);
    source_ = file;
  }
  /// Merges the scene text of another site, and prints the lines for the user. Call share() before.
  void hear(const std::string& site, const std::string& text);
  /// Returns the text of the scene for other sites, once after each change; otherwise no value.
  [[nodiscard]] std::optional<std::string> takeTold() {
    return shared_ ? shared_->takeTold() : std::nullopt;
  }
  /// Replaces the volume that has the image's name, from the next look() on. The replacement
  /// remains if the scene file changes.
  void replace(std::shared_ptr<const IgtlImage> image) { image_ = std::move(image); }
  /// Returns the result of the last image, once; an empty text while there is none.
  [[nodiscard]] std::string takeNews() { return std::exchange(news_, {}); }
  /// Returns a new scene once it is built; otherwise no value. Starts to build a scene if something
  /// has changed.
  std::optional<BuiltScene> look();
  /// Returns the gains of the latest scene, in the order of its modes.
  [[nodiscard]] std::vector<LiveDial> dials() const { return inOrder(felt_, ids_); }
  /// Returns the latest scene, to which no gains are applied.
  [[nodiscard]] const SceneSpec& spec() const noexcept { return spec_; }
  /// Returns the text of the latest scene with the edits of other sites (SceneInput::text). Returns
  /// an empty text while the run has its first scene.
  [[nodiscard]] const std::string& text() const noexcept { return text_; }
  /// Returns the last rejected request for gains (LiveWishes::dialled). A rejected request leaves
  /// the gains unchanged.
  [[nodiscard]] std::uint64_t refused() const noexcept { return refused_; }

 private:
  /// Result of building a scene.
  struct Made {
    SceneSpec spec;
    ModeIds ids;
    BuiltScene built;
    std::string text;
    std::map<std::string, std::shared_ptr<const Volume>> replaced;
    std::optional<SharedScene> shared;
    /// Rejected edits of other sites, with reasons; one line each.
    std::vector<std::string> refused;
    bool same = false;  ///< True if the scene has not changed.
  };
  /// Input for the thread that builds a scene.
  struct Task {
    bool read;    ///< True if the file must be read again.
    bool edited;  ///< True if edits of other sites must be taken over.
    bool still;   ///< True if the gains have not changed.
    Dials dials;
    std::optional<SharedScene> shared;
    std::shared_ptr<const IgtlImage> image;  ///< Image to take over; null: none.
  };
  /// Least time between two edits of other sites. Each edit may start an engagement, which must end
  /// before the next edit.
  static constexpr auto kBetweenEdits = std::chrono::seconds(2);

  [[nodiscard]] bool changed();
  /// Starts a thread that builds the scene, if the file, an edit, the image or the gains have
  /// changed.
  void startBuild();
  /// Returns the scene that a thread has built. If the build has failed, reports the errors and
  /// returns no value. Also returns no value if the scene is unchanged.
  [[nodiscard]] std::optional<BuiltScene> takeBuilt();
  /// Makes a built scene the present scene and returns it; no value if it is unchanged. `image` is
  /// the image that was taken over, or null.
  [[nodiscard]] std::optional<BuiltScene> adopt(Made made, const IgtlImage* image);
  /// Builds the scene of a task. Runs on the building thread.
  [[nodiscard]] Made make(const Task& task) const;
  /// Builds `spec` with the gains and the images. If it throws, `made` remains unchanged.
  void build(Made& made, SceneSpec spec, const Dials& dials) const;
  /// Builds the scene with as many valid edits of other sites as possible. `read`: reads the scene
  /// file again. `still`: the gains have not changed.
  void buildShared(Made& made, bool read, bool still, const Dials& dials) const;
  /// Prints which edits of other sites are now in the scene, and which were rejected.
  void tellOfEdits(const Made& made);

  SceneSpec spec_;
  ModeIds ids_;
  std::string file_;
  std::string text_;
  bool files_;
  std::vector<const Device*> devices_;
  SceneCache& cache_;
  std::optional<std::filesystem::file_time_type> seen_;
  Dials wanted_;               ///< Gains that the user wants.
  Dials tried_;                ///< Gains of the scene that is being built.
  Dials felt_;                 ///< Gains of the present scene.
  std::uint64_t request_ = 0;  ///< LiveWishes::dialled of wanted_.
  std::uint64_t trying_ = 0;   ///< LiveWishes::dialled of tried_.
  std::uint64_t refused_ = 0;
  bool read_ = false;    ///< True if the build reads the scene file again.
  bool edited_ = false;  ///< True if the build includes edits of other sites.
  std::optional<SharedScene> shared_;
  std::string source_;  ///< The scene file. Differs from `file_` if `file_` is a recording.
  std::set<std::string> refused_edits_;  ///< Rejected edits that were already reported.
  std::chrono::steady_clock::time_point next_edits_;
  /// Volumes that images have replaced.
  std::map<std::string, std::shared_ptr<const Volume>> replaced_;
  std::shared_ptr<const IgtlImage> image_;  ///< Image to take over next, or being taken over.
  bool making_image_ = false;
  std::string news_;
  std::future<Made> made_;
};

}  // namespace palpate::cli
