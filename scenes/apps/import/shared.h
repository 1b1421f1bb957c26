/// Divides an image among the ranks of a process group: slabs along k, the slowest axis of files.
#pragma once

#include <algorithm>
#include <cstddef>
#include <string>
#include <vector>

#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/process_group.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// One rank of a process group. Results for the whole image are combined slice by slice, or by
/// operations that do not depend on the order. They are therefore the same for any number of ranks.
class Shared {
 public:
  explicit Shared(ProcessGroup& group) : group_(&group) {}

  [[nodiscard]] ProcessGroup& group() const { return *group_; }
  [[nodiscard]] bool isAlone() const { return group_->size() == 1; }

  /// Returns this rank's bricks along k, for an image with this number of slices.
  [[nodiscard]] Share bricks(int slices) const {
    return shareOf(*group_, (slices + kBrickSide - 1) / kBrickSide);
  }
  /// Returns the slices in these bricks.
  [[nodiscard]] Slab own(int slices) const {
    const Share share = bricks(slices);
    const int first = static_cast<int>(share.first) * kBrickSide;
    return {first, std::min(static_cast<int>(share.end) * kBrickSide, slices) - first};
  }
  /// Returns these slices and `more` on each side; an empty slab stays empty.
  [[nodiscard]] Slab own(int slices, std::size_t more) const {
    const Slab mine = own(slices);
    if (mine.count == 0) return mine;
    const int by = static_cast<int>(std::min(more, static_cast<std::size_t>(slices)));
    const int first = std::max(mine.first - by, 0);
    return {first, std::min(mine.end() + by, slices) - first};
  }
  /// Returns the slices that the bricks need, with their aprons.
  [[nodiscard]] Slab inBricks(int slices) const { return own(slices, kBrickApron); }

  /// Returns the worst of all ranks' losses, on each rank.
  [[nodiscard]] Loss worst(const Loss& own) const;

 private:
  ProcessGroup* group_;
};

/// Returns only these slices of the array; memory is shared.
[[nodiscard]] Values slicesOf(const Piece& image, const Values& values, const Slab& slices);

}  // namespace palpate::importer
