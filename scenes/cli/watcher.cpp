#include "palpate/scenes/cli/watcher.h"

#include <algorithm>
#include <chrono>
#include <exception>
#include <new>
#include <system_error>

#include "palpate/scenes/cli/common.h"
#include "palpate/scenes/cli/say.h"
#include "palpate/scenes/cli/touch.h"
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

void dial(SceneSpec& spec, const std::vector<double>& factors) {
  constexpr double kOff = 1e-9;
  const std::size_t count = std::min(factors.size(), spec.graph.modes.size());
  for (std::size_t i = 0; i < count; ++i) {
    ModeSpec& mode = spec.graph.modes[i];
    if (factors[i] == 1.0 || mode.kind == ModeKind::kUser) continue;
    mode.strength.factors.push_back({TransferFunction(std::max(factors[i], kOff)), ""});
  }
}

std::vector<double> renumbered(const std::vector<double>& factors, const SceneSpec& from,
                               const SceneSpec& to) {
  std::vector<double> moved(to.graph.modes.size(), 1.0);
  for (std::size_t i = 0; i < moved.size(); ++i) {
    for (std::size_t j = 0; j < std::min(factors.size(), from.graph.modes.size()); ++j) {
      const std::string& name = from.graph.modes[j].name;
      if (!name.empty() && name == to.graph.modes[i].name) moved[i] = factors[j];
    }
  }
  return moved;
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
    try {
      Made made = made_.get();
      if (made.read) {
        factors_ = renumbered(factors_, spec_, made.spec);
        spec_ = std::move(made.spec);
        sayAside("feel: {} has changed: it is felt now\n", file_);
      }
      return std::move(made.built);
    } catch (const std::bad_alloc&) {
      complain(file_ +
               ": there is not enough memory for a second scene: use smaller volumes; the "
               "scene before it goes on");
    } catch (const std::exception& error) {
      complain(std::string(error.what()) + "; the scene before it goes on");
    }
    return std::nullopt;
  }
  const bool read = changed();
  if (!read && !turned_) return std::nullopt;
  turned_ = false;
  made_ = std::async(std::launch::async, [this, read, factors = factors_] {
    Made made;
    made.read = read;
    made.spec = read ? openScene(file_, {}) : spec_;
    SceneSpec spec = made.spec;
    dial(spec, read ? renumbered(factors, spec_, made.spec) : factors);
    (void)fitToAll(spec, devices_);
    made.built = buildScene(spec, {}, &cache_);
    if (!read) return made;
    for (const std::string& note : spec.notes) complain(note);
    for (const std::string& note : made.built.notes) complain(note);
    return made;
  });
  return std::nullopt;
}

}  // namespace palpate::cli
