#include "palpate/scenes/apps/import/slab_group.h"

#include <algorithm>
#include <cmath>

#include "palpate/samplers/bricks/bricks.h"

namespace palpate::importer {

std::vector<ProcessGroup::Bytes> SlabGroup::gather(std::span<const std::byte> own) {
  if (!isDivided()) return processes_.gather(own);
  if (next_ < known_.size()) return known_[next_++];
  pending_.emplace_back(own.begin(), own.end());
  throw Postponed();
}

void SlabGroup::divide(const std::array<int, 3>& size, bool is_slow, int depth) noexcept {
  if (processes_.size() > 1 || slabs_ > 0) return;
  if (is_slow && 1.0 * size[0] * size[1] * size[2] <= 4.0 * most_points_) return;
  const double layer = static_cast<double>(size[0]) * size[1] * kBrickSide;
  const int layers = (size[2] + kBrickSide - 1) / kBrickSide;
  double each = std::clamp(std::floor(most_points_ / layer), 1.0, 1.0 * layers);
  // Each border between slabs decodes up to two more blocks, because slabs overlap.
  const int blocks = (size[2] - 1) / depth + 1;
  const double wanted = std::ceil(layers / (1.0 + std::floor(blocks / 2.0)));
  if (wanted > each) {
    each = std::clamp(std::floor(4.0 * most_points_ / layer), each, wanted);
  }
  slabs_ = static_cast<int>(std::ceil(layers / each));
}

std::vector<Share> SlabGroup::sharesOf(std::int64_t count) {
  if (!isDivided()) return {shareOf(*this, count)};
  std::vector<Share> shares;
  for (slab_ = 0; slab_ < slabs_; ++slab_) shares.push_back(shareOf(*this, count));
  return shares;
}

}  // namespace palpate::importer
