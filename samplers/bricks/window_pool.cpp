#include "palpate/samplers/bricks/window_pool.h"

#include <algorithm>
#include <string>
#include <sys/mman.h>
#include <unistd.h>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

/// Slots that a window needs in addition to the coarsest level: the 27 bricks around a hand.
constexpr std::uint64_t kLeastSlots = 27;
/// Largest share of the machine's memory that the slots of a window may use.
constexpr double kMostOfMemory = 0.75;

}  // namespace

BrickWindow::Pool::Pool(const BrickManifest& manifest, const WindowParams& params)
    : levels(manifest.levels()),
      format(manifest.format()),
      horizon(params.horizon),
      waits(params.waits) {
  slot_bytes = (format.bytes() + 63) / 64 * 64;
  const std::uint64_t brick = slot_bytes;
  std::uint64_t besides = kReading * brick;
  for (const BrickLevel& level : levels) besides += level.bricks() * sizeof(std::uint64_t);
  std::uint64_t stored = 0;
  for (std::int32_t l = 0; l < static_cast<std::int32_t>(levels.size()); ++l) {
    for (const BrickEntry& entry : manifest.entries(l)) {
      stored += entry.kind == BrickKind::kStored ? 1 : 0;
    }
  }
  slots = params.budget > besides ? (params.budget - besides) / brick : 0;
  slots = std::min<std::uint64_t>(slots, stored);
  const std::uint64_t least = std::min(stored, levels.back().bricks() + kLeastSlots);
  if (slots < least || params.budget < besides) {
    throw VolumeError(manifest.info().name,
                      "a window of " + std::to_string(params.budget >> 20U) + " MiB holds " +
                          std::to_string(slots) + " of its bricks",
                      "increase the budget (\"budget_mb\" of \"window\") to " +
                          std::to_string(((least * brick + besides) >> 20U) + 1) + " MiB or more");
  }
  const double machine =
      static_cast<double>(sysconf(_SC_PHYS_PAGES)) * static_cast<double>(sysconf(_SC_PAGESIZE));
  if (static_cast<double>(slots * brick) > kMostOfMemory * machine) {
    throw VolumeError(manifest.info().name,
                      "a window of " + std::to_string(slots * brick >> 20U) +
                          " MiB is more than 75 % of the machine's memory",
                      "reduce the budget (\"budget_mb\" of \"window\")");
  }
  constants.push_back({manifest.background(), false});
  for (const BrickLevel& level : levels) {
    tables.emplace_back(static_cast<std::size_t>(level.bricks()));
    const auto n = static_cast<std::int32_t>(tables.size() - 1);
    const Entry background(Entry::kConstant, 0, 0);
    for (auto& entry : tables.back()) entry.store(background.bits(), std::memory_order_relaxed);
    for (const BrickEntry& entry : manifest.entries(n)) {
      Entry at;
      if (entry.kind != BrickKind::kStored) {
        at = Entry(Entry::kConstant, static_cast<std::uint32_t>(constants.size()), 0);
        constants.push_back({entry.value, entry.kind == BrickKind::kActive});
      }
      this->entry({n, entry.at}).store(at.bits(), std::memory_order_relaxed);
    }
  }
  arrivals = std::vector<std::atomic<std::int64_t>>(slots);
  const std::size_t bytes = std::max<std::size_t>(slots, 1) * slot_bytes;
  void* mapped = mmap(nullptr, bytes, PROT_READ | PROT_WRITE,
                      MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (mapped == MAP_FAILED) {
    throw VolumeError(
        manifest.info().name,
        "the system has too little memory for a window of " + std::to_string(bytes >> 20U) + " MiB",
        "reduce the budget (\"budget_mb\" of \"window\")");
  }
  memory = static_cast<std::byte*>(mapped);
  // With pages of 4 KB, the rows of a cell would lie on four or more pages.
  (void)madvise(mapped, bytes, MADV_HUGEPAGE);
  locked = params.lock && mlock(mapped, bytes) == 0;
}

BrickWindow::Pool::~Pool() {
  if (memory != nullptr) munmap(memory, std::max<std::size_t>(slots, 1) * slot_bytes);
}

}  // namespace palpate
