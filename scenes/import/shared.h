/// What of an image a rank of a crew imports: slabs along k, the axis in which files are slowest.
#pragma once

#include <algorithm>
#include <cstddef>
#include <string>
#include <vector>

#include "palpate/samplers/bricks.h"
#include "palpate/samplers/crew.h"
#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// A rank among the others. Whatever is of the whole image is put together slice by slice or by
/// what knows no order, so that it is the same for any number of ranks.
class Shared {
 public:
  explicit Shared(Crew& crew) : crew_(&crew) {}

  [[nodiscard]] Crew& crew() const { return *crew_; }
  [[nodiscard]] bool isAlone() const { return crew_->size() == 1; }

  /// The bricks that are this rank's, along k, of an image with so many slices.
  [[nodiscard]] Share bricks(int slices) const {
    return shareOf(*crew_, (slices + kBrickSide - 1) / kBrickSide);
  }
  /// The slices in them.
  [[nodiscard]] Slab own(int slices) const {
    const Share share = bricks(slices);
    const int first = static_cast<int>(share.first) * kBrickSide;
    return {first, std::min(static_cast<int>(share.end) * kBrickSide, slices) - first};
  }
  /// With so many more on each side; none about none.
  [[nodiscard]] Slab own(int slices, std::size_t more) const {
    const Slab mine = own(slices);
    if (mine.count == 0) return mine;
    const int by = static_cast<int>(std::min(more, static_cast<std::size_t>(slices)));
    const int first = std::max(mine.first - by, 0);
    return {first, std::min(mine.end() + by, slices) - first};
  }
  /// What bricks need: their aprons as well.
  [[nodiscard]] Slab inBricks(int slices) const { return own(slices, kBrickApron); }

  /// One loss of all.
  [[nodiscard]] Loss worst(const Loss& own) const;

 private:
  Crew* crew_;
};

/// The array with these of its slices alone, shared.
[[nodiscard]] Values slicesOf(const Piece& image, const Values& values, const Slab& slices);

}  // namespace palpate::importer
