/// Rebuilds a scene that changes during a run.
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

/// Fits the coupling to all devices: lowers a stiffness that the user has not set. Throws
/// SceneError if a device still cannot render the coupling. Returns true if lowered.
[[nodiscard]] bool fitToAll(SceneSpec& spec, const std::vector<const Device*>& devices);

/// Rebuilds a scene if its file, its gains or the image of a volume change, or if another site
/// edits it. Building runs on a separate thread, so that keys and faults are handled in the
/// meantime. If the new scene has errors, reports them and keeps the present scene.
class Watcher {
 public:
  /// `spec`: the present scene as in its file, written at `seen` and fitted to all `devices`.
  /// `files`: watch the file.
  Watcher(SceneSpec spec, std::string file, std::optional<std::filesystem::file_time_type> seen,
          bool files, std::vector<const Device*> devices, SceneCache& cache)
      : spec_(std::move(spec)),
        ids_(idsOf(spec_)),
        file_(std::move(file)),
        files_(files),
        devices_(std::move(devices)),
        cache_(cache),
        seen_(seen) {}

  /// Changes gains at the next look(); gains of modes that are gone by then are ignored. `request`:
  /// LiveWishes::dialled.
  void turn(const std::vector<LiveDial>& dials, std::uint64_t request);
  /// Returns true if the previous image was taken into the scene or rejected: one image at a time.
  [[nodiscard]] bool takesImage() const noexcept { return image_ == nullptr && !made_.valid(); }
  /// Makes the scene a shared one. `site`: this site's name. `file` and `text`: of the present
  /// scene (SceneInput).
  void share(const std::string& site, const std::string& file, const std::string& text) {
    shared_.emplace(site, text);
    source_ = file;
  }
  /// Takes an edit of another site. Call share() first.
  void hear(const std::string& site, const std::string& text);
  /// Returns the text for other sites, if it has changed.
  [[nodiscard]] std::optional<std::string> takeTold() {
    return shared_ ? shared_->takeTold() : std::nullopt;
  }
  /// Replaces the volume that has the image's name, at the next look() and from then on, also after
  /// changes of the file.
  void replace(std::shared_ptr<const IgtlImage> image) { image_ = std::move(image); }
  /// Returns the result for the last image, once; empty: not known yet.
  [[nodiscard]] std::string takeNews() { return std::exchange(news_, {}); }
  /// Returns the new scene; unset if not ready.
  std::optional<BuiltScene> look();
  /// Returns the gains of the modes in the latest scene, by their numbers.
  [[nodiscard]] std::vector<LiveDial> dials() const { return inOrder(felt_, ids_); }
  /// Returns the latest scene, without gains.
  [[nodiscard]] const SceneSpec& spec() const noexcept { return spec_; }
  /// Returns the text of the latest scene (SceneInput::text), with other sites' edits, if look()
  /// has made it; empty: the text is that of the first scene.
  [[nodiscard]] const std::string& text() const noexcept { return text_; }
  /// Returns the last rejected request; its gains are unchanged.
  [[nodiscard]] std::uint64_t refused() const noexcept { return refused_; }

 private:
  /// A scene that is being built.
  struct Made {
    SceneSpec spec;
    ModeIds ids;
    BuiltScene built;
    std::string text;
    std::map<std::string, std::shared_ptr<const Volume>> replaced;
    std::optional<SharedScene> shared;
    std::vector<std::string> refused;  ///< Rejected edits of other sites, a line each.
    bool same = false;                 ///< The scene is unchanged.
  };
  /// The present state for a thread that builds a scene.
  struct Task {
    bool read;    ///< Read the file again.
    bool edited;  ///< Take over other sites' edits.
    bool still;   ///< Gains are unchanged.
    Dials dials;
    std::optional<SharedScene> shared;
    std::shared_ptr<const IgtlImage> image;  ///< Null: no new image.
  };
  /// Each edit may start an engagement, which ends before the next edit.
  static constexpr auto kBetweenEdits = std::chrono::seconds(2);

  [[nodiscard]] bool changed();
  /// Starts a thread that builds the scene, if the file, edits, the image or gains have changed.
  void startBuild();
  /// Returns the scene that a thread has built; unset if it is unchanged or has errors, which are
  /// reported.
  [[nodiscard]] std::optional<BuiltScene> takeBuilt();
  /// Replaces the present scene; returns it, unset if it is unchanged. `image`: null if not new.
  [[nodiscard]] std::optional<BuiltScene> adopt(Made made, const IgtlImage* image);
  /// Builds the scene of a task, on the building thread.
  [[nodiscard]] Made make(const Task& task) const;
  /// Builds `spec` with gains and images. Leaves `made` unchanged if it throws.
  void build(Made& made, SceneSpec spec, const Dials& dials) const;
  /// Builds the file, read again or not, with as many of the other sites' edits as are valid.
  /// `still`: gains are unchanged.
  void buildShared(Made& made, bool read, bool still, const Dials& dials) const;
  /// Reports which edits are active now, and which are rejected.
  void tellOfEdits(const Made& made);

  SceneSpec spec_;
  ModeIds ids_;
  std::string file_;
  std::string text_;
  bool files_;
  std::vector<const Device*> devices_;
  SceneCache& cache_;
  std::optional<std::filesystem::file_time_type> seen_;
  Dials wanted_;               ///< Gains as last set,
  Dials tried_;                ///< in the scene that is being built,
  Dials felt_;                 ///< and in the present scene.
  std::uint64_t request_ = 0;  ///< Request of wanted_.
  std::uint64_t trying_ = 0;   ///< Request of tried_.
  std::uint64_t refused_ = 0;
  bool read_ = false;    ///< The scene that is being built is read from the file,
  bool edited_ = false;  ///< or has other sites' edits.
  std::optional<SharedScene> shared_;
  std::string source_;  ///< The scene's file; differs from `file_` if that is a recording.
  std::set<std::string> refused_edits_;  ///< Rejections as last reported.
  std::chrono::steady_clock::time_point next_edits_;
  std::map<std::string, std::shared_ptr<const Volume>> replaced_;  ///< Volumes from images.
  std::shared_ptr<const IgtlImage> image_;  ///< Next image, or the one being built.
  bool making_image_ = false;
  std::string news_;
  std::future<Made> made_;
};

}  // namespace palpate::cli
