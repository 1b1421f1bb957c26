/// Private to samplers, for .cpp files only: memory that a window's readers and loader share.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "palpate/samplers/bricks/brick_window.h"
#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/bricks/hand_report.h"

namespace palpate {

/// The slots and tables of a window. Any thread may read the tables. Only the loader writes them.
struct BrickWindow::Pool {
  /// Memory beyond the pool [bricks]: the brick that is being read, compressed and decompressed.
  static constexpr std::uint64_t kReading = 2;
  /// Arrival time of bricks that do not fade in, because they arrived far from all proxies [ns].
  static constexpr std::int64_t kLongAgo = std::numeric_limits<std::int64_t>::min();

  struct Constant {
    std::array<float, 3> value{};
    bool active = false;
  };

  explicit Pool(const BrickManifest& manifest, const WindowParams& params);
  Pool(const Pool&) = delete;
  Pool& operator=(const Pool&) = delete;
  ~Pool();

  /// Returns the index, along one axis, of the brick from which a cell is read: the brick that owns
  /// the cell's lowest corner. The first brick also serves the cell just before it.
  /// @param first  BrickLevel::first along the axis.
  [[nodiscard]] static int brickOf(int cell, int first) noexcept {
    constexpr int kShift = 6;
    static_assert(1 << kShift == kBrickSide);
    return ((cell == kBrickSide * first - 1 ? cell + 1 : cell) >> kShift) - first;
  }
  [[nodiscard]] std::byte* slotAt(std::size_t slot) const noexcept {
    return memory + slot * slot_bytes;
  }
  /// Returns the index of a cell's brick in the level's table; std::nullopt outside of the level.
  [[nodiscard]] std::optional<std::size_t> placeOf(std::int32_t level, int i, int j,
                                                   int k) const noexcept {
    const BrickLevel& of = levels[static_cast<std::size_t>(level)];
    std::size_t place = 0;
    const std::array<int, 3> cell{i, j, k};
    for (std::size_t a = 0; a < 3; ++a) {
      const int at = brickOf(cell[a], of.first[a]);
      if (at < 0 || at >= of.count[a]) return std::nullopt;
      place = place * static_cast<std::size_t>(of.count[a]) + static_cast<std::size_t>(at);
    }
    return place;
  }
  [[nodiscard]] std::atomic<std::uint64_t>& entry(const BrickId& id) noexcept {
    const auto l = static_cast<std::size_t>(id.level);
    std::size_t place = 0;
    for (std::size_t a = 0; a < 3; ++a) {
      place =
          place * static_cast<std::size_t>(levels[l].count[a]) + static_cast<std::size_t>(id.at[a]);
    }
    return tables[l][place];
  }
  [[nodiscard]] Entry entryOf(const BrickId& id) noexcept {
    return Entry(entry(id).load(std::memory_order_relaxed));
  }

  /// A counter with its own cache line.
  struct alignas(64) Count {
    std::atomic<std::uint32_t> readers{0};
  };
  /// Readers that have entered and not left, per side. The loader swaps the sides, and then waits
  /// until the old side has no reader.
  mutable std::array<Count, 2> in;
  std::atomic<std::uint64_t> changes{0};
  std::vector<BrickLevel> levels;
  BrickFormat format;
  /// For each level, Entry::bits() of its bricks.
  std::vector<std::vector<std::atomic<std::uint64_t>>> tables;
  /// Values of bricks that have only one value. Entry 0 is the background.
  std::vector<Constant> constants;
  /// For each slot, the arrival time of its brick [ns of the steady clock].
  std::vector<std::atomic<std::int64_t>> arrivals;
  std::atomic<double> horizon;         ///< Present look-ahead time [s].
  std::atomic<std::uint32_t> side{0};  ///< Side on which readers enter now.
  bool waits;
  std::array<detail::HandReport, kMostHands> hands;
  std::atomic<std::size_t> numbered{0};  ///< Number of calls of newHand().
  /// Number of events that require a new choice of requests: reports of moved hands, and hands that
  /// begin or end their reports.
  std::atomic<std::uint64_t> aimed{0};
  std::byte* memory = nullptr;  ///< Memory of all slots, in the order of their indices.
  std::size_t slots = 0;
  std::size_t slot_bytes = 0;  ///< Size of a slot [bytes], a multiple of 64.
  bool locked = false;
};

}  // namespace palpate
