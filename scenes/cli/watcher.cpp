#include "palpate/scenes/cli/watcher.h"

#include <chrono>
#include <exception>
#include <new>
#include <system_error>

#include "palpate/scenes/cli/say.h"
#include "palpate/scenes/cli/touch.h"
#include "palpate/scenes/scene_file.h"

namespace palpate::cli {

std::optional<std::filesystem::file_time_type> writtenAt(const std::string& file) {
  std::error_code error;
  const auto time = std::filesystem::last_write_time(file, error);
  if (error) return std::nullopt;
  return time;
}

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

std::optional<BuiltScene> Watcher::look() {
  if (made_.valid()) {
    if (made_.wait_for(std::chrono::seconds(0)) != std::future_status::ready) return std::nullopt;
    try {
      BuiltScene built = made_.get();
      sayAside("feel: {} has changed: it is felt now\n", file_);
      return built;
    } catch (const std::bad_alloc&) {
      complain(file_ +
               ": there is not enough memory for a second scene: use smaller volumes; the "
               "scene before it goes on");
    } catch (const std::exception& error) {
      complain(std::string(error.what()) + "; the scene before it goes on");
    }
    return std::nullopt;
  }
  const auto now = writtenAt(file_);
  if (!now || now == seen_) return std::nullopt;
  seen_ = now;
  std::error_code error;
  if (!std::filesystem::is_regular_file(file_, error) &&
      !std::filesystem::is_directory(file_, error)) {
    complain(file_ + ": it is not a file any more; the scene before it goes on");
    return std::nullopt;
  }
  made_ = std::async(std::launch::async, [this] {
    SceneSpec spec = openScene(file_, {});
    (void)fitToAll(spec, devices_);
    BuiltScene built = buildScene(spec, {}, &cache_);
    for (const std::string& note : spec.notes) complain(note);
    for (const std::string& note : built.notes) complain(note);
    return built;
  });
  return std::nullopt;
}

}  // namespace palpate::cli
