/// Caches the components of a scene, so that the next scene reuses the unchanged components.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "palpate/samplers/bricks/brick_window.h"
#include "palpate/samplers/grid/derive.h"
#include "palpate/samplers/grid/label_mask.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "palpate/samplers/time/frame_sequence.h"
#include "palpate/samplers/time/warp_grid.h"

namespace palpate {

/// Calls functions that load or build components, and reuses results for equal inputs. If a new
/// scene has the same fields and kinds of modes as the previous one, and no motions, the force
/// stays on when the scenes change (Scene::shape). Only one thread may use a cache.
class SceneCache {
 public:
  /// Calls loadVolumes. Loads a file again if the size or the modification time of the file has
  /// changed since its last load.
  [[nodiscard]] std::vector<LoadResult> load(const std::vector<VolumeRequest>& requests,
                                             const std::function<void(double)>& progress);
  /// Calls deriveVolume.
  [[nodiscard]] std::shared_ptr<const Volume> derive(const std::shared_ptr<const Volume>& volume,
                                                     Derivation what);
  /// Calls makeLabelMask.
  [[nodiscard]] std::shared_ptr<const Volume> mask(const std::shared_ptr<const Volume>& volume,
                                                   const std::vector<LabelKey>& labels,
                                                   double sigma);
  /// Calls makeVdbField.
  [[nodiscard]] FieldPtr field(const std::shared_ptr<const Volume>& volume,
                               const Placement& placement, const Sampling& sampling);
  /// A brick window and its coarsest level.
  struct Bricks {
    std::shared_ptr<const BrickWindow> window;  ///< Not null.
    std::shared_ptr<const Volume> coarsest;     ///< BrickWindow::coarsest().
  };
  /// Calls openBricks. Calls the constructor of BrickWindow if no entry has the same place,
  /// parameters and BrickManifest::identity. Throws VolumeError.
  [[nodiscard]] Bricks bricks(const std::filesystem::path& place, const WindowParams& params);
  /// Calls makeBrickField.
  [[nodiscard]] FieldPtr field(const std::shared_ptr<const BrickWindow>& window,
                               const Placement& placement, double slope_reach);
  /// A sequence: its frames with their times, its place and its sampling.
  struct Played {
    std::vector<VolumeRequest> frames;  ///< One or more.
    FrameTimes when;                    ///< Times of `frames`.
    Placement placement;                ///< Placement in W.
    Sampling sampling;                  ///< Interpolation between voxels.
    SequenceParams params;              ///< Memory limit, and whether readers wait.

    /// Returns true if both structures describe the same sequence.
    [[nodiscard]] bool operator==(const Played&) const = default;
  };
  /// Calls the constructor of FrameSequence. Loads the frames again if the modification time of a
  /// file has changed.
  [[nodiscard]] std::shared_ptr<const FrameSequence> sequence(const Played& wanted);
  /// Calls makeSequenceField.
  [[nodiscard]] FieldPtr field(const std::shared_ptr<const FrameSequence>& sequence);
  /// A volume with its place and its sampling.
  struct Placed {
    std::shared_ptr<const Volume> volume;  ///< Not null.
    Placement placement;                   ///< Placement in W.
    Sampling sampling;                     ///< Interpolation between voxels.

    /// Compares the addresses of the volumes, not their content.
    [[nodiscard]] bool operator==(const Placed&) const = default;
  };
  /// Calls makeWarp with displacementsOf.
  [[nodiscard]] WarpPtr warp(const std::vector<std::shared_ptr<const Volume>>& frames,
                             const Placement& placement, const WarpTimes& when,
                             const std::string& path);
  /// Calls makeVdbField for each entry, in parallel.
  [[nodiscard]] std::vector<FieldPtr> fields(const std::vector<Placed>& wanted);
  /// Scope in which one scene is built. done() discards all entries that this scene did not use.
  /// Without done(), the end of the scope discards all entries that the previous scene did not use.
  class Building {
   public:
    explicit Building(SceneCache& of) noexcept
        : of_(of) {}  ///< Only one scope may exist at a time.
    Building(const Building&) = delete;
    Building& operator=(const Building&) = delete;
    ~Building() {
      if (!done_) of_.forget(&Mark::kept);
    }
    /// The scene is complete: discards all entries that it did not use.
    void done() {
      done_ = true;
      of_.forget(&Mark::used);
    }

   private:
    SceneCache& of_;
    bool done_ = false;
  };
  /// Returns the total number of entries.
  [[nodiscard]] std::size_t size() const noexcept {
    return volumes_.size() + derived_.size() + masks_.size() + fields_.size() + warps_.size() +
           bricks_.size() + windowed_.size() + sequences_.size() + sequenced_.size();
  }

 private:
  struct Mark {
    bool used = true;   ///< True if the scene that is being built has requested the entry.
    bool kept = false;  ///< True if the previous scene has requested the entry.
  };
  /// Removes the entries in whose mark the member `unless` is false.
  void forget(bool Mark::*unless);

  template <class Key, class Value>
  class Shelf {
   public:
    [[nodiscard]] Value* find(const Key& key) {
      const auto [begin, end] = entries_.equal_range(hashOf(key));
      const auto entry =
          std::find_if(begin, end, [&](const auto& e) { return e.second.key == key; });
      if (entry == end) return nullptr;
      entry->second.mark.used = true;
      return &entry->second.value;
    }
    const Value& keep(const Key& key, Value value) {
      return entries_.emplace(hashOf(key), Entry{key, std::move(value), {}})->second.value;
    }
    [[nodiscard]] std::size_t size() const noexcept { return entries_.size(); }
    void forget(bool Mark::*unless) {
      std::erase_if(entries_, [&](const auto& e) { return !(e.second.mark.*unless); });
      for (auto& [hash, entry] : entries_) entry.mark = {false, true};
    }

   private:
    struct Entry {
      Key key;
      Value value;
      Mark mark;
    };
    std::unordered_multimap<std::size_t, Entry> entries_;
  };

  struct Loaded {
    VolumeRequest request;
    std::filesystem::file_time_type time;
    std::uintmax_t size = 0;

    [[nodiscard]] bool operator==(const Loaded&) const = default;
  };
  struct Derived {
    std::shared_ptr<const Volume> volume;
    Derivation what;

    [[nodiscard]] bool operator==(const Derived&) const = default;
  };
  struct Masked {
    std::shared_ptr<const Volume> volume;
    std::vector<LabelKey> labels;
    double sigma = 0.0;

    [[nodiscard]] bool operator==(const Masked&) const = default;
  };
  struct Displaced {
    std::vector<std::shared_ptr<const Volume>> frames;
    Placement placement;
    std::vector<double> times;
    bool repeat = false;

    [[nodiscard]] bool operator==(const Displaced&) const = default;
  };
  struct Opened {
    std::filesystem::path place;
    std::uint64_t identity = 0;
    WindowParams params;

    [[nodiscard]] bool operator==(const Opened&) const = default;
  };
  struct Kept {
    Played played;
    std::vector<std::filesystem::file_time_type> times;

    [[nodiscard]] bool operator==(const Kept&) const = default;
  };
  struct Sequenced {
    std::shared_ptr<const FrameSequence> sequence;

    [[nodiscard]] bool operator==(const Sequenced&) const = default;
  };
  struct Windowed {
    std::shared_ptr<const BrickWindow> window;
    Placement placement;
    double slope_reach = 0.0;

    [[nodiscard]] bool operator==(const Windowed&) const = default;
  };
  static std::size_t hashOf(const Opened& key);
  static std::size_t hashOf(const Windowed& key);
  static std::size_t hashOf(const Kept& key);
  static std::size_t hashOf(const Sequenced& key);
  static std::size_t hashOf(const Loaded& key);
  static std::size_t hashOf(const Derived& key);
  static std::size_t hashOf(const Masked& key);
  static std::size_t hashOf(const Placed& key);
  static std::size_t hashOf(const Displaced& key);

  Shelf<Loaded, std::shared_ptr<const Volume>> volumes_;
  Shelf<Derived, std::shared_ptr<const Volume>> derived_;
  Shelf<Masked, std::shared_ptr<const Volume>> masks_;
  Shelf<Placed, FieldPtr> fields_;
  Shelf<Displaced, WarpPtr> warps_;
  Shelf<Opened, Bricks> bricks_;
  Shelf<Windowed, FieldPtr> windowed_;
  Shelf<Kept, std::shared_ptr<const FrameSequence>> sequences_;
  Shelf<Sequenced, FieldPtr> sequenced_;
};

}  // namespace palpate
