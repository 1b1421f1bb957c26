/// Divides an image among the ranks of a process group: by slices along k, the slowest axis.
#pragma once

#include <algorithm>
#include <cstddef>
#include <string>
#include <vector>

#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/process_group.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/slab_group.h"

namespace palpate::importer {

/// One rank of a process group. Results for the whole image are the same for any number of ranks.
class Shared {
 public:
  explicit Shared(ProcessGroup& group) : group_(&group) {}
  explicit Shared(SlabGroup& slabs) : group_(&slabs), slabs_(&slabs) {}

  [[nodiscard]] ProcessGroup& group() const { return *group_; }
  [[nodiscard]] bool isAlone() const { return group_->size() == 1; }
  /// Returns true if all ranks' bytes for the next gather() are known (SlabGroup::isKnown).
  [[nodiscard]] bool isKnown() const { return slabs_ != nullptr && slabs_->isKnown(); }
  /// Returns of(list), where `list` joins the lists of all ranks in order (SlabGroup::reduced).
  template <class T, class Item>
  [[nodiscard]] T reduced(const std::vector<Item>& own, T (*of)(std::vector<Item> list)) const {
    return slabs_ == nullptr ? of(gatherAll(*group_, own)) : slabs_->reduced(own, of);
  }

  [[nodiscard]] Share bricks(int slices) const {
    return shareOf(*group_, (slices + kBrickSide - 1) / kBrickSide);
  }
  [[nodiscard]] Slab own(int slices) const {
    const Share share = bricks(slices);
    const int first = static_cast<int>(share.first) * kBrickSide;
    return {first, std::min(static_cast<int>(share.end) * kBrickSide, slices) - first};
  }
  /// Returns own() and `more` slices on each side; empty if own() is empty.
  [[nodiscard]] Slab own(int slices, std::size_t more) const {
    const Slab mine = own(slices);
    if (mine.count == 0) return mine;
    const int by = static_cast<int>(std::min(more, static_cast<std::size_t>(slices)));
    const int first = std::max(mine.first - by, 0);
    return {first, std::min(mine.end() + by, slices) - first};
  }

  /// Returns the most serious loss of all ranks. Every rank gets the same result.
  [[nodiscard]] Loss worst(const Loss& own) const;

 private:
  ProcessGroup* group_;
  SlabGroup* slabs_ = nullptr;
};

/// Returns the part of `values` for the slices. `values` has a tuple for each point of
/// image.slices(). The result shares the memory of `values`.
[[nodiscard]] Values slicesOf(const Piece& image, const Values& values, const Slab& slices);

}  // namespace palpate::importer
