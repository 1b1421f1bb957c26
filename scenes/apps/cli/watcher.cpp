#include "palpate/scenes/apps/cli/watcher.h"

#include <algorithm>
#include <chrono>
#include <exception>
#include <map>
#include <new>
#include <system_error>
#include <vector>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/cli/recorded.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/apps/common/say.h"
#include "palpate/scenes/library/scene_file.h"

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
  complain(file_ + ": it is now neither a file nor a folder; the previous scene stays active");
  return false;
}

void Watcher::hear(const std::string& site, const std::string& text) {
  for (const std::string& line : shared_->hear(site, text)) complain("feel: " + line);
}

void Watcher::build(Made& made, SceneSpec spec, const Dials& dials) const {
  ModeIds ids = idsOf(spec, spec_, ids_);
  SceneSpec felt = spec;
  dial(felt, inOrder(dials, ids));
  for (const auto& [name, volume] : made.replaced) {
    const auto known = felt.volumes.find(name);
    if (known != felt.volumes.end()) known->second.volume = volume;
  }
  made.built = buildScene(felt, {}, &cache_);
  made.spec = std::move(spec);
  made.ids = std::move(ids);
}

void Watcher::buildShared(Made& made, bool read, bool still, const Dials& dials) const {
  SharedScene& shared = *made.shared;
  if (read) shared.edit(openWithText(file_, {}).text);
  const SharedEdits before = shared.felt();
  const auto with = [&](SharedEdits edits) {
    std::string text = shared.textWith(edits);
    SceneSpec spec = parseScene(text, source_, std::filesystem::path(source_).parent_path());
    spec.waits = spec_.waits;
    (void)fitToAll(spec, devices_);
    build(made, std::move(spec), dials);
    made.text = std::move(text);
    shared.feel(std::move(edits));
  };
  constexpr std::size_t kMostTries = 16;
  const std::vector<SharedEdits> in_order = shared.inOrder(kMostTries);
  SharedEdits all;
  for (const SharedEdits& edit : in_order) all.insert(edit.begin(), edit.end());
  made.same = !read && still && all == before;
  if (made.same) return;
  try {
    with(all);
    return;
  } catch (const std::exception&) {
    if (all.empty()) throw;
  }
  // Tries the edits one by one. The call without edits throws if the scene file is wrong.
  with({});
  SharedEdits felt;
  for (const SharedEdits& edit : in_order) {
    SharedEdits more = felt;
    more.insert(edit.begin(), edit.end());
    try {
      with(more);
      felt = std::move(more);
    } catch (const std::exception& error) {
      std::vector<SharedKey> of;
      for (const auto& [key, one] : edit) of.push_back(key);
      made.refused.push_back(fmt::format("site {}: its edit of {} is rejected: {}",
                                         edit.begin()->second.stamp.site, wordsFor(of),
                                         error.what()));
    }
  }
  made.same = !read && still && felt == before;
}

void Watcher::tellOfEdits(const Made& made) {
  for (const std::string& line : made.refused) {
    if (!refused_edits_.contains(line)) complain("feel: " + line);
  }
  refused_edits_ = {made.refused.begin(), made.refused.end()};
  const SharedEdits& before = shared_->felt();
  const SharedEdits& now = made.shared->felt();
  SharedEdits tried;  // all edits that differ from the file
  for (const SharedEdits& edit : made.shared->inOrder(1)) tried.insert(edit.begin(), edit.end());
  std::map<std::string, std::vector<SharedKey>> changed;
  for (const auto& [key, edit] : made.shared->edits()) {
    const auto old = before.find(key);
    const auto one = now.find(key);
    if (one == now.end() && tried.contains(key)) continue;  // rejected: in made.refused
    const bool same = old == before.end() || one == now.end()
                          ? (old == before.end()) == (one == now.end())
                          : old->second == one->second;
    // Edits of this site are reported as a change of the scene file.
    if (!same && !(read_ && edit.stamp.site == shared_->site())) {
      changed[edit.stamp.site].push_back(key);
    }
  }
  // One program can send edits under the names of many sites, so the number of lines is limited.
  constexpr std::size_t kMostLines = 4;
  std::size_t lines = 0;
  for (const auto& [site, keys] : changed) {
    if (++lines > kMostLines) {
      sayAside("feel: {} more sites have edited the scene\n", changed.size() - kMostLines);
      break;
    }
    sayAside("feel: {}\n",
             sentence(fmt::format("site {}: its edit of {} is active", site, wordsFor(keys))));
  }
}

std::optional<BuiltScene> Watcher::look() {
  if (!made_.valid()) {
    startBuild();
    return std::nullopt;
  }
  if (made_.wait_for(std::chrono::seconds(0)) != std::future_status::ready) return std::nullopt;
  return takeBuilt();
}

std::optional<BuiltScene> Watcher::takeBuilt() {
  const std::shared_ptr<const IgtlImage> image =
      std::exchange(making_image_, false) ? std::exchange(image_, nullptr) : nullptr;
  try {
    return adopt(made_.get(), image.get());
  } catch (const std::bad_alloc&) {
    if (image != nullptr)
      news_ = {image->name + ": not enough memory for this image: send a smaller image", true};
    complain(file_ +
             ": not enough memory for the edited scene beside the previous one, which stays "
             "active: use smaller volumes, or start palpate again");
  } catch (const std::exception& error) {
    if (image != nullptr) news_ = {error.what(), true};
    complain(std::string(error.what()) + "; the previous scene stays active");
  }
  // The gains may still be valid, so the next build tries them with the present scene.
  if (read_ && edited_) shared_->renew();
  if (read_ || edited_ || image != nullptr) return std::nullopt;
  refused_ = trying_;
  if (wanted_ == tried_) wanted_ = felt_;
  return std::nullopt;
}

std::optional<BuiltScene> Watcher::adopt(Made made, const IgtlImage* image) {
  if (made.shared) {
    tellOfEdits(made);
    shared_->settle(*made.shared);
  }
  if (made.same) return std::nullopt;
  replaced_ = std::move(made.replaced);
  if (image != nullptr) {
    news_ = {image->name + ": the image is active", false};
    sayAside("feel: {}\n", sentence(news_.text));
  }
  felt_ = tried_;
  if (edited_) next_edits_ = std::chrono::steady_clock::now() + kBetweenEdits;
  if (read_ || edited_) {
    spec_ = std::move(made.spec);
    ids_ = std::move(made.ids);
    text_ = std::move(made.text);
  }
  if (read_) sayAside("feel: {} has changed: the new scene is active\n", file_);
  return std::move(made.built);
}

void Watcher::startBuild() {
  read_ = changed();
  const auto now = std::chrono::steady_clock::now();
  edited_ = shared_ && now >= next_edits_ && shared_->takeNews();
  if (edited_) next_edits_ = now + kBetweenEdits;
  // Gains precede images: a reduced strength must not wait for a stream of images.
  making_image_ = !read_ && !edited_ && image_ != nullptr && wanted_ == felt_;
  if (!read_ && !edited_ && !making_image_ && wanted_ == felt_) return;
  const bool still = wanted_ == felt_ || making_image_;
  tried_ = making_image_ ? felt_ : wanted_;
  trying_ = request_;
  made_ = std::async(std::launch::async,
                     [this, task = Task{read_, edited_, still, tried_, shared_,
                                        making_image_ ? image_ : nullptr}] { return make(task); });
}

Watcher::Made Watcher::make(const Task& task) const {
  Made made{spec_, ids_, {}, {}, replaced_, {}, {}, false};
  if (task.image != nullptr) made.replaced[task.image->name] = volumeOf(*task.image);
  if (task.shared && (task.read || task.edited)) {
    made.shared = task.shared;
    buildShared(made, task.read, task.still, task.dials);
  } else if (task.read) {
    SceneInput opened = openWithText(file_, {});
    made.text = std::move(opened.text);
    opened.spec.waits = spec_.waits;
    (void)fitToAll(opened.spec, devices_);
    build(made, std::move(opened.spec), task.dials);
  } else {
    build(made, spec_, task.dials);
  }
  if (made.same || !(task.read || task.edited || task.image != nullptr)) return made;
  if (task.read || task.edited) {
    for (const std::string& note : made.spec.notes) complain(note);
  }
  for (const std::string& note : made.built.notes) complain(note);
  return made;
}

}  // namespace palpate::cli
