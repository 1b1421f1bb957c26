#include "palpate/scenes/apps/import/shared.h"

#include <span>

namespace palpate::importer {

Loss Shared::worst(const Loss& own) const {
  Loss worst;
  for (const ProcessGroup::Bytes& bytes : group_->gather(std::as_bytes(std::span(own)))) {
    const Loss one(reinterpret_cast<const char*>(bytes.data()), bytes.size());
    if (worst.empty() || one == kLossBeyond) worst = one;
  }
  return worst;
}

Values slicesOf(const Piece& image, const Values& values, const Slab& slices) {
  if (values.none() || slices == image.slices()) return values;
  const std::size_t slice =
      static_cast<std::size_t>(image.size[0]) * static_cast<std::size_t>(image.size[1]);
  return values.part(slice * static_cast<std::size_t>(slices.first - image.slices().first),
                     slice * static_cast<std::size_t>(slices.count));
}

}  // namespace palpate::importer
