/// What scenes are made of, kept so that the next one takes what has not changed.
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

#include "palpate/samplers/brick_window.h"
#include "palpate/samplers/derive.h"
#include "palpate/samplers/frame_sequence.h"
#include "palpate/samplers/vdb_field.h"
#include "palpate/samplers/volume.h"
#include "palpate/samplers/warp_grid.h"

namespace palpate {

/// Gives what it made before from the same things; a scene built of the same fields is an edit of
/// the one before it, for a hand (Scene::shape). One thread.
class SceneCache {
 public:
  /// As loadVolumes. A file that has been written to since is loaded anew.
  [[nodiscard]] std::vector<LoadResult> load(const std::vector<VolumeRequest>& requests,
                                             const std::function<void(double)>& progress);
  /// As deriveVolume.
  [[nodiscard]] std::shared_ptr<const Volume> derive(const std::shared_ptr<const Volume>& volume,
                                                     Derivation what);
  /// As makeVdbField.
  [[nodiscard]] FieldPtr field(const std::shared_ptr<const Volume>& volume,
                               const Placement& placement, const Sampling& sampling);
  /// A window of bricks, and its coarsest level.
  struct Bricks {
    std::shared_ptr<const BrickWindow> window;  ///< Not null.
    std::shared_ptr<const Volume> coarsest;     ///< BrickWindow::coarsest().
  };
  /// As openBricks and the constructor of BrickWindow. What was written anew is opened anew. Throws
  /// VolumeError.
  [[nodiscard]] Bricks bricks(const std::filesystem::path& place, const WindowParams& params);
  /// As makeBrickField.
  [[nodiscard]] FieldPtr field(const std::shared_ptr<const BrickWindow>& window,
                               const Placement& placement);
  /// The frames of a sequence, when they are, and where and how they are read.
  struct Played {
    std::vector<VolumeRequest> frames;  ///< One or more.
    FrameTimes when;                    ///< Of these.
    Placement placement;                ///< Where in W.
    Sampling sampling;                  ///< How it is read between voxels.
    SequenceParams params;              ///< What it may take.

    [[nodiscard]] bool operator==(const Played&) const = default;  ///< For the same sequence.
  };
  /// As the constructor of FrameSequence. Frames that were written anew since are loaded anew.
  [[nodiscard]] std::shared_ptr<const FrameSequence> sequence(const Played& wanted);
  /// As makeSequenceField.
  [[nodiscard]] FieldPtr field(const std::shared_ptr<const FrameSequence>& sequence);
  /// What stands somewhere, and how it is read.
  struct Placed {
    std::shared_ptr<const Volume> volume;  ///< Not null.
    Placement placement;                   ///< Where in W.
    Sampling sampling;                     ///< How it is read between voxels.

    [[nodiscard]] bool operator==(const Placed&) const = default;  ///< By the volume's address.
  };
  /// As makeWarp of displacementsOf.
  [[nodiscard]] WarpPtr warp(const std::vector<std::shared_ptr<const Volume>>& frames,
                             const Placement& placement, const WarpTimes& when,
                             const std::string& path);
  /// As makeVdbField of each, in parallel.
  [[nodiscard]] std::vector<FieldPtr> fields(const std::vector<Placed>& wanted);
  /// While a scene is built. What it has not asked for is freed when it is done; where it cannot be
  /// built, what it was the first to ask for.
  class Building {
   public:
    explicit Building(SceneCache& of) noexcept : of_(of) {}  ///< One at a time.
    Building(const Building&) = delete;
    Building& operator=(const Building&) = delete;
    ~Building() {
      if (!done_) of_.forget(&Mark::kept);
    }
    /// The scene is whole.
    void done() {
      done_ = true;
      of_.forget(&Mark::used);
    }

   private:
    SceneCache& of_;
    bool done_ = false;
  };
  /// Things that are kept.
  [[nodiscard]] std::size_t size() const noexcept {
    return volumes_.size() + derived_.size() + fields_.size() + warps_.size() + bricks_.size() +
           windowed_.size() + sequences_.size() + sequenced_.size();
  }

 private:
  struct Mark {
    bool used = true;   ///< By the scene that is being built,
    bool kept = false;  ///< by the one before it.
  };
  /// Frees what is not marked so.
  void forget(bool Mark::*unless);

  template <class Key, class Value>
  class Shelf {
   public:
    /// None where it has none.
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

    [[nodiscard]] bool operator==(const Windowed&) const = default;
  };
  static std::size_t hashOf(const Opened& key);
  static std::size_t hashOf(const Windowed& key);
  static std::size_t hashOf(const Kept& key);
  static std::size_t hashOf(const Sequenced& key);
  static std::size_t hashOf(const Loaded& key);
  static std::size_t hashOf(const Derived& key);
  static std::size_t hashOf(const Placed& key);
  static std::size_t hashOf(const Displaced& key);

  Shelf<Loaded, std::shared_ptr<const Volume>> volumes_;
  Shelf<Derived, std::shared_ptr<const Volume>> derived_;
  Shelf<Placed, FieldPtr> fields_;
  Shelf<Displaced, WarpPtr> warps_;
  Shelf<Opened, Bricks> bricks_;
  Shelf<Windowed, FieldPtr> windowed_;
  Shelf<Kept, std::shared_ptr<const FrameSequence>> sequences_;
  Shelf<Sequenced, FieldPtr> sequenced_;
};

}  // namespace palpate
