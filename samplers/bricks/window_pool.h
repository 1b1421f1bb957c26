/// Private to samplers: the memory of a window, which its readers and its loader share. Include it
/// in .cpp files only.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "palpate/engine/types.h"
#include "palpate/samplers/bricks/brick_window.h"
#include "palpate/samplers/bricks/bricks.h"

namespace palpate {

/// The last report of a hand: a seqlock, written by one thread and read by another.
struct BrickWindow::HandReport {
  std::atomic<std::uint32_t> count{0};
  std::atomic<std::uint32_t> beats{0};  ///< Number of ticks.
  std::array<std::atomic<double>, 9> numbers{};

  void write(const Aim& at) noexcept {
    const std::uint32_t begun = count.load(std::memory_order_relaxed) | 1U;
    count.store(begun, std::memory_order_relaxed);
    for (std::size_t i = 0; i < 3; ++i) {
      const auto a = static_cast<Eigen::Index>(i);
      numbers[i].store(at.proxy[a], std::memory_order_release);
      numbers[3 + i].store(at.probe[a], std::memory_order_release);
      numbers[6 + i].store(at.velocity[a], std::memory_order_release);
    }
    count.store(begun + 1U, std::memory_order_release);
  }
  /// Returns the values written last. For the writer only.
  [[nodiscard]] Aim last() const noexcept {
    Aim out;
    for (std::size_t i = 0; i < 3; ++i) {
      const auto a = static_cast<Eigen::Index>(i);
      out.proxy[a] = numbers[i].load(std::memory_order_acquire);
      out.probe[a] = numbers[3 + i].load(std::memory_order_acquire);
      out.velocity[a] = numbers[6 + i].load(std::memory_order_acquire);
    }
    return out;
  }
  /// Returns std::nullopt if no report was written, or one is being written.
  [[nodiscard]] std::optional<Aim> read() const noexcept {
    const std::uint32_t before = count.load(std::memory_order_acquire);
    if (before == 0 || (before & 1U) != 0) return std::nullopt;
    const Aim out = last();
    if (count.load(std::memory_order_relaxed) != before) return std::nullopt;
    return out;
  }
};

/// Slots and tables. All threads read the tables; only the loader writes them.
struct BrickWindow::Pool {
  /// A window needs memory for this many more bricks: the compressed and the decompressed data of
  /// the brick that is being read.
  static constexpr std::uint64_t kReading = 2;
  /// Arrival time of bricks that were never awaited [ns].
  static constexpr std::int64_t kLongAgo = std::numeric_limits<std::int64_t>::min();

  /// A brick of one value.
  struct Constant {
    std::array<float, 3> value{};
    bool active = false;
  };

  explicit Pool(const BrickManifest& manifest, const WindowParams& params);
  Pool(const Pool&) = delete;
  Pool& operator=(const Pool&) = delete;
  ~Pool();

  /// Returns the brick that a cell is read from, along one axis. This is the brick that owns the
  /// cell's lowest corner, except that the cell before the first brick is read from the first
  /// brick, whose apron has its voxels.
  /// @param first  BrickLevel::first along the axis.
  [[nodiscard]] static int brickOf(int cell, int first) noexcept {
    constexpr int kShift = 6;
    static_assert(1 << kShift == kBrickSide);
    return ((cell == kBrickSide * first - 1 ? cell + 1 : cell) >> kShift) - first;  // rounds down
  }
  [[nodiscard]] std::byte* slotAt(std::size_t slot) const noexcept {
    return memory + slot * slot_bytes;
  }
  /// Returns the place of the brick of a cell in the table of its level; std::nullopt beyond the
  /// level.
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
  /// Returns the entry of a brick. The pyramid must have its place.
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

  /// Number of registered readers. Each count has a cache line of its own.
  struct alignas(64) Count {
    std::atomic<std::uint32_t> readers{0};
  };
  mutable std::array<Count, 2> in;        ///< Readers that entered each side.
  std::atomic<std::uint64_t> changes{0};  ///< Changes of the tables.
  std::vector<BrickLevel> levels;
  BrickFormat format;
  std::vector<std::vector<std::atomic<std::uint64_t>>> tables;  ///< Entry::bits() per level.
  std::vector<Constant> constants;                              ///< Number 0 is the background.
  std::vector<std::atomic<std::int64_t>> arrivals;  ///< Per slot: time [ns of the steady clock].
  std::atomic<double> horizon;                      ///< Present look-ahead [s].
  std::atomic<std::uint32_t> side{0};               ///< The side that readers enter now.
  bool waits;                                       ///< WindowParams::waits.
  std::array<HandReport, kMostHands> hands;
  std::atomic<std::size_t> numbered{0};  ///< Calls of newHand().
  std::atomic<std::uint64_t> aimed{
      0};                       ///< Counts the changes after which the loader chooses again.
  std::byte* memory = nullptr;  ///< The slots, one after the other.
  std::size_t slots = 0;        ///< Number of slots.
  std::size_t slot_bytes = 0;   ///< Size of a slot, a multiple of 64.
  bool locked = false;          ///< See WindowState::locked.
};

}  // namespace palpate
