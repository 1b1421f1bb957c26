#include "palpate/samplers/bricks/brick_pyramid.h"

#include <algorithm>
#include <array>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

/// Edge of a brick at half the resolution [voxels].
constexpr int kHalf = kBrickSide / 2;
/// A voxel belongs to a level set's band if both signs occur within this distance [voxels].
constexpr int kPyramidReach = 3;
/// Number of coarser voxels around a brick's own voxels that coarserBrick() computes, on each side.
constexpr int kAround = kBrickApron + kPyramidReach;
constexpr int kBlock = kBrickSide + 2 * kAround;

constexpr std::size_t blockNumber(int i, int j, int k) noexcept {
  return (static_cast<std::size_t>(i) * kBlock + static_cast<std::size_t>(j)) * kBlock +
         static_cast<std::size_t>(k);
}

float rounded(double sum, const BrickFormat& format) noexcept {
  const auto mean = static_cast<float>(0.125 * sum);
  return format.half ? floatOfHalf(halfOfFloat(mean)) : mean;
}

/// Returns the indices of a brick's children and of the bricks next to them, 4 along each axis.
std::array<VoxelAt, 64> placesBelow(const BrickManifest& manifest, std::int32_t finer,
                                    const VoxelAt& at) {
  const BrickLevel& fine = manifest.levels()[static_cast<std::size_t>(finer)];
  const BrickLevel& coarse = manifest.levels()[static_cast<std::size_t>(finer) + 1];
  std::array<VoxelAt, 64> places{};
  for (std::size_t n = 0; n < places.size(); ++n) {
    const std::array<std::int32_t, 3> step{static_cast<std::int32_t>(n / 16),
                                           static_cast<std::int32_t>(n / 4 % 4),
                                           static_cast<std::int32_t>(n % 4)};
    for (std::size_t a = 0; a < 3; ++a) {
      places[n][a] = 2 * (coarse.first[a] + at[a]) - 1 + step[a] - fine.first[a];
    }
  }
  return places;
}

/// Combines every byte of the block by OR with all bytes within kPyramidReach of it along one axis.
void spread(std::vector<std::uint8_t>& from, std::vector<std::uint8_t>& to, std::size_t stride) {
  std::copy(from.begin(), from.end(), to.begin());
  const std::size_t size = from.size();
  for (std::size_t s = 1; s <= kPyramidReach; ++s) {
    const std::size_t by = s * stride;
    // Near the edges, this combines bytes of opposite edges. The caller does not read these
    // results.
    for (std::size_t n = 0; n + by < size; ++n) to[n] |= from[n + by];
    for (std::size_t n = by; n < size; ++n) to[n] |= from[n - by];
  }
  from.swap(to);
}

/// Returns the Morton code of a brick's index. Bricks with successive codes are mostly near each
/// other.
std::uint64_t mortonOf(const VoxelAt& at) noexcept {
  std::uint64_t code = 0;
  for (unsigned bit = 0; bit < 21; ++bit) {
    for (unsigned a = 0; a < 3; ++a) {
      code |= std::uint64_t{(static_cast<std::uint32_t>(at[a]) >> bit) & 1U} << (3 * bit + 2 - a);
    }
  }
  return code;
}

constexpr std::size_t kBlockVoxels = std::size_t{kBlock} * kBlock * kBlock;

/// Copies a finer halved brick into the block, at index `step` of its 4 x 4 x 4 bricks.
void copyIntoBlock(const HalvedBrick& halved, const std::array<int, 3>& step,
                   std::size_t components, CoarserSpace& space) {
  // `begin` is the position of the finer brick's first voxel in the block. `low` and `high` bound
  // its voxels that are in the block.
  std::array<int, 3> begin{};
  std::array<int, 3> low{};
  std::array<int, 3> high{};
  for (std::size_t a = 0; a < 3; ++a) {
    begin[a] = (step[a] - 1) * kHalf + kAround;
    low[a] = std::max(0, -begin[a]);
    high[a] = std::min(kHalf, kBlock - begin[a]);
  }
  const auto count = static_cast<std::size_t>(high[2] - low[2]);
  for (int i = low[0]; i < high[0]; ++i) {
    for (int j = low[1]; j < high[1]; ++j) {
      const std::size_t to = blockNumber(begin[0] + i, begin[1] + j, begin[2] + low[2]);
      if (halved.kind == BrickKind::kStored) {
        const std::size_t from =
            (static_cast<std::size_t>(i) * kHalf + static_cast<std::size_t>(j)) * kHalf +
            static_cast<std::size_t>(low[2]);
        std::copy_n(halved.values.data() + from * components, count * components,
                    space.values.data() + to * components);
        std::copy_n(halved.active.data() + from, count, space.active.data() + to);
      } else {
        for (std::size_t n = 0; n < count; ++n) {
          std::copy_n(halved.value.data(), components, space.values.data() + (to + n) * components);
        }
        std::fill_n(space.active.data() + to, count,
                    static_cast<std::uint8_t>(halved.kind == BrickKind::kActive));
      }
    }
  }
}

/// Activates the voxels of a level set's band: those with both signs within kPyramidReach voxels.
void activateBand(CoarserSpace& space) {
  space.signs.resize(kBlockVoxels);
  space.other.resize(kBlockVoxels);
  std::uint8_t all = 0;
  for (std::size_t n = 0; n < kBlockVoxels; ++n) {
    space.signs[n] = space.values[n] < 0.0F ? 1 : 2;
    all |= space.signs[n];
  }
  if (all != 3) return;
  for (const std::size_t stride :
       {std::size_t{1}, std::size_t{kBlock}, std::size_t{kBlock} * kBlock}) {
    spread(space.signs, space.other, stride);
  }
  for (std::size_t n = 0; n < kBlockVoxels; ++n) {
    space.active[n] |= static_cast<std::uint8_t>(space.signs[n] == 3);
  }
}

void cutBrick(const CoarserSpace& space, std::size_t components, std::span<float> values,
              std::span<std::uint8_t> active) {
  std::fill(active.begin(), active.end(), std::uint8_t{0});
  for (int i = -kBrickApron; i < kBrickSide + kBrickApron; ++i) {
    for (int j = -kBrickApron; j < kBrickSide + kBrickApron; ++j) {
      const std::size_t from = blockNumber(i + kAround, j + kAround, kPyramidReach);
      const std::size_t to = BrickView::numberOf(i, j, -kBrickApron);
      std::copy_n(space.values.data() + from * components, kBrickEdge * components,
                  values.data() + to * components);
      for (std::size_t n = 0; n < kBrickEdge; ++n) {
        active[(to + n) / 8] |= static_cast<std::uint8_t>(space.active[from + n] << ((to + n) % 8));
      }
    }
  }
}

}  // namespace

HalvedBricks::HalvedBricks(BrickSource& source, std::int32_t level)
    : source_(source), level_(level) {}

std::shared_ptr<const HalvedBrick> HalvedBricks::of(const VoxelAt& at) {
  {
    const std::lock_guard lock(mutex_);
    const auto found = by_place_.find(at);
    if (found != by_place_.end()) {
      kept_.splice(kept_.begin(), kept_, found->second);
      return found->second->second;
    }
  }
  const BrickEntry entry = manifest().entry({level_, at});
  std::shared_ptr<const HalvedBrick> halved = make(entry);
  if (halved->kind != BrickKind::kStored) return halved;
  const std::lock_guard lock(mutex_);
  // Another thread may have made the same halved brick since the look-up.
  if (by_place_.count(at) != 0) return halved;
  kept_.emplace_front(at, halved);
  by_place_[at] = kept_.begin();
  if (kept_.size() > kMost) {
    by_place_.erase(kept_.back().first);
    kept_.pop_back();
  }
  return halved;
}

std::shared_ptr<const HalvedBrick> HalvedBricks::make(const BrickEntry& entry) {
  auto halved = std::make_shared<HalvedBrick>();
  halved->kind = entry.kind;
  halved->value = entry.value;
  if (entry.kind != BrickKind::kStored) return halved;
  const BrickFormat& format = manifest().format();
  std::vector<std::byte> slot(format.bytes());
  const BrickArrival arrival = source_.read({level_, entry.at}, slot);
  if (arrival.status != BrickStatus::kArrived) {
    // `why` is "file: reason: remedy".
    const auto colon = arrival.why.find(": ");
    const auto last = arrival.why.rfind(": ");
    const std::string reason = arrival.why.substr(colon + 2, last - colon - 2);
    throw VolumeError(arrival.why.substr(0, colon),
                      "a brick of this export cannot be read back (" + reason + ")",
                      "check the disk, and run the same command again");
  }
  const BrickView view(format, slot.data());
  const std::size_t components = format.components();
  halved->values.resize(std::size_t{kHalf} * kHalf * kHalf * components);
  halved->active.resize(std::size_t{kHalf} * kHalf * kHalf);
  std::size_t n = 0;
  for (int i = 0; i < kBrickSide; i += 2) {
    for (int j = 0; j < kBrickSide; j += 2) {
      for (int k = 0; k < kBrickSide; k += 2, ++n) {
        std::array<std::size_t, 8> eight{};
        for (int c = 0; c < 8; ++c) {
          eight[static_cast<std::size_t>(c)] =
              BrickView::numberOf(i + (c >> 2), j + ((c >> 1) & 1), k + (c & 1));
        }
        for (std::size_t c = 0; c < components; ++c) {
          double sum = 0.0;
          for (const std::size_t one : eight) sum += static_cast<double>(view.value(one, c));
          halved->values[n * components + c] = rounded(sum, format);
        }
        halved->active[n] = static_cast<std::uint8_t>(std::any_of(
            eight.begin(), eight.end(), [&](std::size_t one) { return view.active(one); }));
      }
    }
  }
  return halved;
}

bool coarserBrick(HalvedBricks& finer, const VoxelAt& at, bool level_set, CoarserSpace& space,
                  std::span<float> values, std::span<std::uint8_t> active) {
  const std::size_t components = finer.manifest().format().components();
  const auto places = placesBelow(finer.manifest(), finer.level(), at);

  // Saves time: in a sparse volume, all these bricks often have the same single value.
  const BrickEntry first = finer.manifest().entry({finer.level(), places[0]});
  const bool uniform = std::all_of(places.begin(), places.end(), [&](const VoxelAt& place) {
    const BrickEntry one = finer.manifest().entry({finer.level(), place});
    return one.kind != BrickKind::kStored && one.kind == first.kind && one.value == first.value;
  });
  if (uniform) {
    std::copy_n(first.value.begin(), components, values.begin());
    active[0] = first.kind == BrickKind::kActive ? 1 : 0;
    return true;
  }

  space.values.resize(kBlockVoxels * components);
  space.active.resize(kBlockVoxels);
  for (std::size_t p = 0; p < places.size(); ++p) {
    const std::array<int, 3> step{static_cast<int>(p / 16), static_cast<int>(p / 4 % 4),
                                  static_cast<int>(p % 4)};
    copyIntoBlock(*finer.of(places[p]), step, components, space);
  }
  if (level_set) activateBand(space);
  cutBrick(space, components, values, active);
  return false;
}

std::vector<VoxelAt> coarserPlaces(const BrickManifest& manifest, std::int32_t finer) {
  const BrickLevel& fine = manifest.levels()[static_cast<std::size_t>(finer)];
  const BrickLevel& coarse = manifest.levels()[static_cast<std::size_t>(finer) + 1];
  std::vector<std::pair<std::uint64_t, VoxelAt>> ordered;
  ordered.reserve(manifest.entries(finer).size());
  for (const BrickEntry& entry : manifest.entries(finer)) {
    // An entry affects its parent, and neighbours of the parent: two indices along each axis.
    for (int n = 0; n < 8; ++n) {
      VoxelAt at{};
      bool there = true;
      for (std::size_t a = 0; a < 3; ++a) {
        const std::int32_t global = fine.first[a] + entry.at[a];
        const std::int32_t aside = ((n >> a) & 1) != 0 ? ((global & 1) != 0 ? 1 : -1) : 0;
        at[a] = (global >> 1) + aside - coarse.first[a];
        there = there && at[a] >= 0 && at[a] < coarse.count[a];
      }
      if (there) ordered.emplace_back(mortonOf(at), at);
    }
  }
  std::sort(ordered.begin(), ordered.end());
  ordered.erase(std::unique(ordered.begin(), ordered.end()), ordered.end());
  std::vector<VoxelAt> places;
  places.reserve(ordered.size());
  for (const auto& [code, at] : ordered) places.push_back(at);
  return places;
}

}  // namespace palpate
