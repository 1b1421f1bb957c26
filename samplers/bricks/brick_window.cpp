#include "palpate/samplers/bricks/brick_window.h"

#include <chrono>
#include <optional>
#include <utility>

#include "palpate/samplers/bricks/half.h"
#include "palpate/samplers/bricks/window_loader.h"
#include "palpate/samplers/bricks/window_pool.h"

namespace palpate {
namespace {

/// Movement of a proxy or probe since the last written report that requires a new choice of
/// requests [voxels of level 0].
constexpr double kMoved = 8.0;
/// Change of a hand's predicted displacement that requires a new choice [voxels of level 0].
constexpr double kMovedAhead = kBrickSide / 2.0;

}  // namespace

BrickWindow::BrickWindow(std::unique_ptr<BrickSource> source, const WindowParams& params)
    : source_(std::move(source)),
      params_(params),
      pool_(std::make_unique<Pool>(source_->manifest(), params)),
      loader_(std::make_unique<Loader>(*source_, *pool_)) {}

BrickWindow::~BrickWindow() = default;

std::size_t BrickWindow::newHand() const noexcept {
  return pool_->numbered.fetch_add(1, std::memory_order_relaxed) % kMostHands;
}

void BrickWindow::aim(std::size_t hand, const Aim& at) const noexcept {
  if (hand >= kMostHands) return;
  detail::HandReport& told = pool_->hands[hand];
  const std::optional<Aim> last = told.read();
  const double horizon = pool_->horizon.load(std::memory_order_relaxed);
  told.beats.fetch_add(1, std::memory_order_release);
  const auto near = [](const Vec3& a, const Vec3& b, double most) {
    return (a - b).squaredNorm() <= most * most;  // false for NaN
  };
  if (last && near(at.proxy, last->proxy, kMoved) && near(at.probe, last->probe, kMoved) &&
      near(horizon * at.velocity, horizon * last->velocity, kMovedAhead)) {
    return;
  }
  if (told.tryWrite(at)) pool_->aimed.fetch_add(1, std::memory_order_release);
}

BrickWindow::Entry BrickWindow::entryAt(std::int32_t level, int i, int j, int k) const noexcept {
  const auto place = pool_->placeOf(level, i, j, k);
  if (!place) return {Entry::kConstant, 0, 0};
  return Entry(
      pool_->tables[static_cast<std::size_t>(level)][*place].load(std::memory_order_acquire));
}

std::int64_t BrickWindow::arrival(const Entry& entry) const noexcept {
  return entry.kind() == Entry::kSlot
             ? pool_->arrivals[entry.index()].load(std::memory_order_relaxed)
             : Pool::kLongAgo;
}

std::uint32_t BrickWindow::enter() const noexcept {
  while (true) {
    const std::uint32_t side = pool_->side.load();
    pool_->in[side].readers.fetch_add(1);
    if (pool_->side.load() == side) return side;
    // The loader has changed the side, so it may free slots without waiting for this reader. It
    // changes the side at most once per brick, so a further try soon succeeds.
    pool_->in[side].readers.fetch_sub(1);
  }
}

void BrickWindow::leave(std::uint32_t side) const noexcept {
  pool_->in[side].readers.fetch_sub(1);
}

std::uint64_t BrickWindow::changes() const noexcept {
  return pool_->changes.load(std::memory_order_acquire);
}

bool BrickWindow::cellAt(const Entry& entry, std::int32_t level, const std::array<int, 3>& cell,
                         Cell& out) const noexcept {
  const Pool& pool = *pool_;
  const std::size_t components = pool.format.components();
  out.active = 0;
  if (entry.kind() == Entry::kAbsent) return false;
  if (entry.kind() == Entry::kConstant) {
    const Pool::Constant& constant = pool.constants[entry.index()];
    for (std::size_t n = 0; n < 4 * components; ++n) out.room[n] = constant.value[n % components];
    out.rows.fill(out.room.data());
    out.active = constant.active ? ~std::uint64_t{0} : 0;
    return true;
  }
  const std::byte* const slot = pool.slotAt(entry.index());
  const BrickLevel& of = pool.levels[static_cast<std::size_t>(level)];
  std::array<int, 3> local{};
  for (std::size_t a = 0; a < 3; ++a) {
    const int at = Pool::brickOf(cell[a], of.first[a]);
    local[a] = cell[a] - kBrickSide * (at + of.first[a]);
  }
  const auto* const values = reinterpret_cast<const float*>(slot);
  const auto* const halves = reinterpret_cast<const std::uint16_t*>(slot);
  const auto* const bits = reinterpret_cast<const std::uint32_t*>(slot + pool.format.activeBegin());
  const std::size_t corner = BrickView::numberOf(local[0] - 1, local[1] - 1, local[2] - 1);
  for (std::size_t row = 0; row < 16; ++row) {
    const std::size_t a = row / 4;
    const std::size_t b = row % 4;
    const std::size_t first = corner + (a * kBrickEdge + b) * kBrickEdge;
    if (pool.format.half) {
      float* const to = out.room.data() + row * 4 * components;
      for (std::size_t n = 0; n < 4 * components; ++n) {
        to[n] = floatOfHalf(halves[first * components + n]);
      }
      out.rows[row] = to;
    } else {
      out.rows[row] = values + first * components;
    }
    // No kernel uses the rows at the rim along both axes, and scalars use no row at the rim.
    const int rims = static_cast<int>(a % 3 == 0) + static_cast<int>(b % 3 == 0);
    if (rims > (components == 1 ? 0 : 1)) continue;
    // Reads four active bits, which may lie in one word or in two.
    const std::size_t shift = first % 32;
    std::uint32_t four = bits[first / 32] >> shift;
    if (shift > 28) four |= bits[first / 32 + 1] << (32 - shift);
    out.active |= std::uint64_t{four & 15U} << (row * 4);
  }
  return true;
}

WindowState BrickWindow::state() const {
  WindowState out;
  out.slots = pool_->slots;
  out.resident = loader_->resident;
  out.bytes = (pool_->slots + Pool::kReading) * pool_->slot_bytes;
  for (const auto& table : pool_->tables) out.bytes += table.size() * sizeof(table[0]);
  out.fetched = loader_->fetched;
  out.locked = pool_->locked;
  out.gone = loader_->gone;
  const std::lock_guard lock(loader_->mutex);
  out.failed = loader_->failing.size();
  return out;
}

bool BrickWindow::lost() const noexcept {
  return loader_->gone.load(std::memory_order_relaxed);
}

std::shared_ptr<const Volume> BrickWindow::coarsest() const {
  return loadBricks(*source_, static_cast<std::int32_t>(pool_->levels.size() - 1),
                    manifest().info().name);
}

std::vector<std::string> BrickWindow::takeTroubles() const {
  const std::lock_guard lock(loader_->mutex);
  return std::exchange(loader_->troubles, {});
}

bool BrickWindow::settle(double seconds) const {
  return loader_->settle(Loader::Clock::now() + std::chrono::duration_cast<Loader::Clock::duration>(
                                                    std::chrono::duration<double>(seconds)));
}

}  // namespace palpate
