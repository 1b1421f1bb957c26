/// A scene that changes under the hand.
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

#include "palpate/engine/device.h"
#include "palpate/samplers/volume.h"
#include "palpate/scenes/build_scene.h"
#include "palpate/scenes/cli/dials.h"
#include "palpate/scenes/cli/igtl_message.h"
#include "palpate/scenes/scene_cache.h"
#include "palpate/scenes/site/shared_scene.h"

namespace palpate::cli {

/// A coupling that all devices render: lowered where nobody has asked for it, else refused (throws
/// SceneError). True where it was lowered.
[[nodiscard]] bool fitToAll(SceneSpec& spec, const std::vector<const Device*>& devices);

/// A scene that is made anew when its file changes, its dials are turned, an image comes for one of
/// its volumes or another site edits it, on a thread of its own, so that keys and faults are looked
/// at meanwhile; what is wrong with it is said, and the scene that runs goes on.
class Watcher {
 public:
  /// `spec`: of the scene that runs, as its file has it, written at `seen`, and fitted to all
  /// `devices`. `files`: whether the file is looked at.
  Watcher(SceneSpec spec, std::string file, std::optional<std::filesystem::file_time_type> seen,
          bool files, std::vector<const Device*> devices, SceneCache& cache)
      : spec_(std::move(spec)),
        ids_(idsOf(spec_)),
        file_(std::move(file)),
        files_(files),
        devices_(std::move(devices)),
        cache_(cache),
        seen_(seen) {}

  /// Turns dials with the next look; those of modes that are gone by then are nobody's. `request`:
  /// LiveWishes::dialled.
  void turn(const std::vector<LiveDial>& dials, std::uint64_t request);
  /// One image at a time: the one before has been felt or refused.
  [[nodiscard]] bool takesImage() const noexcept { return image_ == nullptr && !made_.valid(); }
  /// From now on it is a scene of several sites. `site`: this one's name. `file` and `text`: of the
  /// scene that runs (ToFeel).
  void share(const std::string& site, const std::string& file, const std::string& text) {
    shared_.emplace(site, text);
    source_ = file;
  }
  /// Another site says this of it. Not before share().
  void hear(const std::string& site, const std::string& text);
  /// What others are to be told, where that has changed.
  [[nodiscard]] std::optional<std::string> takeTold() {
    return shared_ ? shared_->takeTold() : std::nullopt;
  }
  /// With the next look the volume of the image's name is what that has, from then on, also where
  /// the file changes.
  void replace(std::shared_ptr<const IgtlImage> image) { image_ = std::move(image); }
  /// What has become of it, once; empty: nothing yet.
  [[nodiscard]] std::string takeNews() { return std::exchange(news_, {}); }
  /// The new scene; none where there is none yet.
  std::optional<BuiltScene> look();
  /// Of the modes of the scene that was looked at last, by their numbers.
  [[nodiscard]] std::vector<LiveDial> dials() const { return inOrder(felt_, ids_); }
  /// The scene that was looked at last, without dials.
  [[nodiscard]] const SceneSpec& spec() const noexcept { return spec_; }
  /// What it was made of (ToFeel::text), others' edits in it, if that was by look(); empty: it is
  /// the first scene's.
  [[nodiscard]] const std::string& text() const noexcept { return text_; }
  /// The last request that was refused; its dials are as they were before.
  [[nodiscard]] std::uint64_t refused() const noexcept { return refused_; }

 private:
  /// A scene on its way.
  struct Made {
    SceneSpec spec;
    ModeIds ids;
    BuiltScene built;
    std::string text;
    std::map<std::string, std::shared_ptr<const Volume>> replaced;
    std::optional<SharedScene> shared;
    std::vector<std::string> refused;  ///< Others' edits, a line each.
    bool same = false;                 ///< Nothing of it is to be felt.
  };
  [[nodiscard]] bool changed();
  /// Of `spec`, with dials and images. Changes nothing of `made` where it throws.
  void build(Made& made, SceneSpec spec, const Dials& dials) const;
  /// Of the file, read anew or not, and as many of others' edits as can be felt. `still`: no dial
  /// was turned.
  void buildShared(Made& made, bool read, bool still, const Dials& dials) const;
  /// Says which are felt now, and which are not.
  void tellOfEdits(const Made& made);

  SceneSpec spec_;
  ModeIds ids_;
  std::string file_;
  std::string text_;
  bool files_;
  std::vector<const Device*> devices_;
  SceneCache& cache_;
  std::optional<std::filesystem::file_time_type> seen_;
  Dials wanted_;               ///< As they were turned last,
  Dials tried_;                ///< as they are in the scene that is being made,
  Dials felt_;                 ///< and in the one that runs.
  std::uint64_t request_ = 0;  ///< Of wanted_.
  std::uint64_t trying_ = 0;   ///< Of tried_.
  std::uint64_t refused_ = 0;
  bool read_ = false;    ///< What is being made is read from the file,
  bool edited_ = false;  ///< or has others' edits.
  std::optional<SharedScene> shared_;
  std::string source_;                   ///< Its file: another one where `file_` is a recording.
  std::set<std::string> refused_edits_;  ///< As they were said last.
  std::chrono::steady_clock::time_point next_edits_;
  std::map<std::string, std::shared_ptr<const Volume>> replaced_;  ///< Volumes, by images.
  std::shared_ptr<const IgtlImage> image_;  ///< To be felt next, or being made.
  bool making_image_ = false;
  std::string news_;
  std::future<Made> made_;
};

}  // namespace palpate::cli
