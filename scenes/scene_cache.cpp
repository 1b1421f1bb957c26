#include "scenes/scene_cache.h"

#include <cstddef>
#include <optional>
#include <system_error>
#include <utility>

namespace palpate {

std::vector<LoadResult> SceneCache::load(const std::vector<VolumeRequest>& requests,
                                         const std::function<void(double)>& progress) {
  std::vector<LoadResult> results(requests.size());
  // As they are before they are read: what is written meanwhile is found the next time.
  std::vector<std::optional<Loaded>> keys(requests.size());
  std::vector<VolumeRequest> missing;
  std::vector<std::size_t> places;
  for (std::size_t i = 0; i < requests.size(); ++i) {
    std::error_code bad_time;
    std::error_code bad_size;
    const Loaded key{requests[i], std::filesystem::last_write_time(requests[i].file, bad_time),
                     std::filesystem::file_size(requests[i].file, bad_size)};
    if (!bad_time && !bad_size) keys[i] = key;
    const auto* known = keys[i] ? volumes_.find(key) : nullptr;
    if (known != nullptr) {
      results[i].volume = *known;
      continue;
    }
    missing.push_back(requests[i]);
    places.push_back(i);
  }
  const std::vector<LoadResult> loaded = loadVolumes(missing, progress);
  for (std::size_t j = 0; j < places.size(); ++j) {
    const std::size_t i = places[j];
    results[i] = loaded[j];
    if (loaded[j].volume != nullptr && keys[i]) volumes_.keep(*keys[i], loaded[j].volume);
  }
  return results;
}

std::shared_ptr<const Volume> SceneCache::derive(const std::shared_ptr<const Volume>& volume,
                                                 Derivation what) {
  const Derived key{volume, what};
  if (const auto* known = derived_.find(key)) return *known;
  return derived_.keep(key, deriveVolume(volume, what));
}

FieldPtr SceneCache::field(const std::shared_ptr<const Volume>& volume, const Placement& placement,
                           const Sampling& sampling) {
  const Placed key{volume, placement, sampling};
  if (const auto* known = fields_.find(key)) return *known;
  return fields_.keep(key, makeVdbField(volume, placement, sampling));
}

void SceneCache::forgetUnused() {
  volumes_.forgetUnused();
  derived_.forgetUnused();
  fields_.forgetUnused();
}

}  // namespace palpate
