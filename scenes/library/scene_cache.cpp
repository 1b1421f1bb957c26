#include "palpate/scenes/library/scene_cache.h"

#include <cstddef>
#include <functional>
#include <optional>
#include <string>
#include <system_error>
#include <utility>

#include "palpate/samplers/bricks/brick_field.h"
#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/parallel.h"
#include "palpate/samplers/time/sequence_field.h"
#include "palpate/scenes/library/brick_places.h"

namespace palpate {

std::vector<LoadResult> SceneCache::load(const std::vector<VolumeRequest>& requests,
                                         const std::function<void(double)>& progress) {
  std::vector<LoadResult> results(requests.size());
  // Reads time and size before loading: if a file changes during the load, the next call loads the
  // file again.
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

std::shared_ptr<const Volume> SceneCache::mask(const std::shared_ptr<const Volume>& volume,
                                               const std::vector<LabelKey>& labels, double sigma) {
  const Masked key{volume, labels, sigma};
  if (const auto* known = masks_.find(key)) return *known;
  return masks_.keep(key, makeLabelMask(volume, labels, sigma));
}

FieldPtr SceneCache::field(const std::shared_ptr<const Volume>& volume, const Placement& placement,
                           const Sampling& sampling) {
  const Placed key{volume, placement, sampling};
  if (const auto* known = fields_.find(key)) return *known;
  return fields_.keep(key, makeVdbField(volume, placement, sampling));
}

WarpPtr SceneCache::warp(const std::vector<std::shared_ptr<const Volume>>& frames,
                         const Placement& placement, const WarpTimes& when,
                         const std::string& path) {
  const Displaced key{frames, placement, when.times, when.repeat};
  if (const auto* known = warps_.find(key)) return *known;
  return warps_.keep(key, makeWarp(displacementsOf(frames, placement, path), when, path));
}

SceneCache::Bricks SceneCache::bricks(const std::filesystem::path& place,
                                      const WindowParams& params) {
  std::unique_ptr<BrickSource> source = openBricks(place);
  const Opened key{absolutePlace(place), source->manifest().identity(), params};
  if (const auto* known = bricks_.find(key)) return *known;
  const auto window = std::make_shared<const BrickWindow>(std::move(source), params);
  return bricks_.keep(key, {window, window->coarsest()});
}

FieldPtr SceneCache::field(const std::shared_ptr<const BrickWindow>& window,
                           const Placement& placement, double slope_reach) {
  const Windowed key{window, placement, slope_reach};
  if (const auto* known = windowed_.find(key)) return *known;
  return windowed_.keep(key, makeBrickField(window, placement, slope_reach));
}

std::shared_ptr<const FrameSequence> SceneCache::sequence(const Played& wanted) {
  Kept key{wanted, {}};
  for (const VolumeRequest& frame : wanted.frames) {
    std::error_code unknown;
    key.times.push_back(std::filesystem::last_write_time(frame.file, unknown));
  }
  if (const auto* known = sequences_.find(key)) return *known;
  return sequences_.keep(
      key, std::make_shared<const FrameSequence>(wanted.frames, wanted.when, wanted.placement,
                                                 wanted.sampling, wanted.params));
}

FieldPtr SceneCache::field(const std::shared_ptr<const FrameSequence>& sequence) {
  const Sequenced key{sequence};
  if (const auto* known = sequenced_.find(key)) return *known;
  return sequenced_.keep(key, makeSequenceField(sequence));
}

std::vector<FieldPtr> SceneCache::fields(const std::vector<Placed>& wanted) {
  std::vector<FieldPtr> out(wanted.size());
  std::vector<std::size_t> missing;
  for (std::size_t i = 0; i < wanted.size(); ++i) {
    if (const auto* known = fields_.find(wanted[i])) {
      out[i] = *known;
    } else {
      missing.push_back(i);
    }
  }
  inParallel(missing.size(), [&](std::size_t j) {
    const Placed& key = wanted[missing[j]];
    out[missing[j]] = makeVdbField(key.volume, key.placement, key.sampling);
  });
  for (const std::size_t i : missing) (void)fields_.keep(wanted[i], out[i]);
  return out;
}

std::size_t SceneCache::hashOf(const Loaded& key) {
  return std::hash<std::string>()(key.request.file.native() + "\n" + key.request.grid);
}

std::size_t SceneCache::hashOf(const Derived& key) {
  return std::hash<const void*>()(key.volume.get()) + static_cast<std::size_t>(key.what);
}

std::size_t SceneCache::hashOf(const Masked& key) {
  return std::hash<const void*>()(key.volume.get()) + std::hash<LabelKey>()(key.labels.front());
}

std::size_t SceneCache::hashOf(const Opened& key) {
  return std::hash<std::string>()(key.place.native());
}

std::size_t SceneCache::hashOf(const Windowed& key) {
  return std::hash<const void*>()(key.window.get());
}

std::size_t SceneCache::hashOf(const Kept& key) {
  const VolumeRequest& first = key.played.frames.front();
  return std::hash<std::string>()(first.file.native() + "\n" + first.grid);
}

std::size_t SceneCache::hashOf(const Sequenced& key) {
  return std::hash<const void*>()(key.sequence.get());
}

std::size_t SceneCache::hashOf(const Placed& key) {
  std::size_t hash = std::hash<const void*>()(key.volume.get());
  const auto add = [&](double x) {
    constexpr std::size_t kPrime = 1099511628211ULL;
    hash = (hash ^ std::hash<double>()(x)) * kPrime;
  };
  add(key.placement.scale);
  for (const double x : key.placement.translate) add(x);
  for (const double x : key.placement.rotation.reshaped()) add(x);
  return hash;
}

std::size_t SceneCache::hashOf(const Displaced& key) {
  return std::hash<const void*>()(key.frames.front().get()) + key.frames.size();
}

void SceneCache::forget(bool Mark::*unless) {
  volumes_.forget(unless);
  derived_.forget(unless);
  masks_.forget(unless);
  fields_.forget(unless);
  warps_.forget(unless);
  bricks_.forget(unless);
  windowed_.forget(unless);
  sequences_.forget(unless);
  sequenced_.forget(unless);
}

}  // namespace palpate
