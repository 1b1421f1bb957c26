/// What scenes are made of, kept so that the next one takes what has not changed.
#pragma once

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <vector>

#include "samplers/derive.h"
#include "samplers/vdb_field.h"
#include "samplers/volume.h"

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
  /// Frees what has not been asked for since the last call. After a scene has been built.
  void forgetUnused();

 private:
  template <class Key, class Value>
  class Shelf {
   public:
    /// None where it has none.
    [[nodiscard]] Value* find(const Key& key) {
      const auto entry = std::find_if(entries_.begin(), entries_.end(),
                                      [&](const Entry& e) { return e.key == key; });
      if (entry == entries_.end()) return nullptr;
      entry->used = true;
      return &entry->value;
    }
    const Value& keep(const Key& key, Value value) {
      entries_.push_back({key, std::move(value), true});
      return entries_.back().value;
    }
    void forgetUnused() {
      std::erase_if(entries_, [](const Entry& e) { return !e.used; });
      for (Entry& e : entries_) e.used = false;
    }

   private:
    struct Entry {
      Key key;
      Value value;
      bool used;
    };
    std::vector<Entry> entries_;
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
  struct Placed {
    std::shared_ptr<const Volume> volume;
    Placement placement;
    Sampling sampling;

    [[nodiscard]] bool operator==(const Placed&) const = default;
  };

  Shelf<Loaded, std::shared_ptr<const Volume>> volumes_;
  Shelf<Derived, std::shared_ptr<const Volume>> derived_;
  Shelf<Placed, FieldPtr> fields_;
};

}  // namespace palpate
