#include "palpate/scenes/cli/watcher.h"

#include <algorithm>
#include <chrono>
#include <exception>
#include <new>
#include <system_error>

#include "palpate/scenes/cli/common.h"
#include "palpate/scenes/cli/recorded.h"
#include "palpate/scenes/cli/say.h"
#include "palpate/scenes/scene_file.h"

namespace palpate::cli {

bool fitToAll(SceneSpec& spec, const std::vector<const Device*>& devices) {
  bool lowered = false;
  for (const Device* device : devices) {
    const std::string note = fitCoupling(spec, device->info());
    if (!note.empty()) complain("feel: " + note);
    lowered = lowered || !note.empty();
    checkDevice(spec, device->info());
  }
  return lowered;
}

void Watcher::turn(const std::vector<LiveDial>& dials, std::uint64_t request) {
  request_ = request;
  for (const LiveDial& dial : dials) {
    if (std::find(ids_.of.begin(), ids_.of.end(), dial.mode) == ids_.of.end()) continue;
    wanted_.erase(dial.mode);
    if (dial.factor != 1.0F) wanted_.emplace(dial.mode, dial.factor);
  }
}

bool Watcher::changed() {
  if (!files_) return false;
  const auto now = writtenAt(file_);
  if (!now || now == seen_) return false;
  seen_ = now;
  std::error_code error;
  if (std::filesystem::is_regular_file(file_, error) ||
      std::filesystem::is_directory(file_, error)) {
    return true;
  }
  complain(file_ + ": it is not a file any more; the scene before it goes on");
  return false;
}

std::optional<BuiltScene> Watcher::look() {
  if (made_.valid()) {
    if (made_.wait_for(std::chrono::seconds(0)) != std::future_status::ready) return std::nullopt;
    const std::shared_ptr<const IgtlImage> image =
        std::exchange(making_image_, false) ? std::exchange(image_, nullptr) : nullptr;
    try {
      Made made = made_.get();
      replaced_ = std::move(made.replaced);
      if (image != nullptr) {
        news_ = image->name + ": the image is felt now";
        sayAside("feel: {}\n", sentence(news_));
      }
      felt_ = tried_;
      if (read_) {
        spec_ = std::move(made.spec);
        ids_ = std::move(made.ids);
        text_ = std::move(made.text);
        sayAside("feel: {} has changed: it is felt now\n", file_);
      }
      return std::move(made.built);
    } catch (const std::bad_alloc&) {
      if (image != nullptr) news_ = image->name + ": there is not enough memory for it";
      complain(file_ +
               ": there is not enough memory for a second scene: use smaller volumes; the "
               "scene before it goes on");
    } catch (const std::exception& error) {
      if (image != nullptr) news_ = error.what();
      complain(std::string(error.what()) + "; the scene before it goes on");
    }
    // A file or an image that is wrong says nothing of dials: they are tried with the scene before
    // it.
    if (read_ || image != nullptr) return std::nullopt;
    refused_ = trying_;
    if (wanted_ == tried_) wanted_ = felt_;
    return std::nullopt;
  }
  read_ = changed();
  // Dials first: who turns a strength down is not to wait for who streams images.
  making_image_ = !read_ && image_ != nullptr && wanted_ == felt_;
  if (!read_ && !making_image_ && wanted_ == felt_) return std::nullopt;
  tried_ = making_image_ ? felt_ : wanted_;
  trying_ = request_;
  made_ = std::async(std::launch::async, [this, read = read_, dials = tried_,
                                          image = making_image_ ? image_ : nullptr] {
    Made made{spec_, ids_, {}, {}, replaced_};
    if (image != nullptr) made.replaced[image->name] = volumeOf(*image);
    if (read) {
      ToFeel opened = openWithText(file_, {});
      made.text = std::move(opened.text);
      made.spec = std::move(opened.spec);
      made.spec.waits = spec_.waits;
      (void)fitToAll(made.spec, devices_);
      made.ids = idsOf(made.spec, spec_, ids_);
    }
    SceneSpec spec = made.spec;
    dial(spec, inOrder(dials, made.ids));
    for (const auto& [name, volume] : made.replaced) {
      const auto known = spec.volumes.find(name);
      if (known != spec.volumes.end()) known->second.volume = volume;
    }
    made.built = buildScene(spec, {}, &cache_);
    if (!read && image == nullptr) return made;
    if (read) {
      for (const std::string& note : made.spec.notes) complain(note);
    }
    for (const std::string& note : made.built.notes) complain(note);
    return made;
  });
  return std::nullopt;
}

}  // namespace palpate::cli
