/// A window of bricks around the hands: the part in memory of a volume larger than memory.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <thread>
#include <vector>

#include "palpate/samplers/bricks/bricks.h"

namespace palpate {

/// Limits and look-ahead of a window.
struct WindowParams {
  std::uint64_t budget = 256ULL << 20;  ///< For pool, tables and fetches in progress [bytes].
  double horizon = 0.25;  ///< Look-ahead at a hand's present velocity [s]; the window looks farther
                          ///< if bricks take long to arrive (BrickSource::delay).
  bool lock = true;       ///< Locks the pool in memory, if that is allowed.
  bool waits = false;     ///< A field's attend() waits for all requested bricks, 60 s at most: for
                          ///< virtual time, where equal motions have to give equal forces.

  [[nodiscard]] bool operator==(const WindowParams&) const = default;  ///< Same window.
};

/// Present content and counters of a window.
struct WindowState {
  std::uint64_t slots = 0;     ///< Bricks that the pool can hold.
  std::uint64_t resident = 0;  ///< Bricks in the pool, including the coarsest level.
  std::uint64_t bytes = 0;     ///< For pool, tables and fetches in progress.
  std::uint64_t fetched = 0;   ///< Bricks fetched, including those at the start.
  std::uint64_t failed = 0;    ///< Failed bricks: read at a coarser level, retried.
  bool locked = false;         ///< The pool is locked in memory.
  bool gone = false;           ///< See lost().
};

/// A pool of bricks of all levels around the hands. A loader thread keeps it full, finest where a
/// hand is and soon will be. The whole coarsest level is always loaded.
///
/// One pool serves any number of readers, which take no lock. The loader never overwrites a brick
/// that a reader sees. It removes the brick from the tables, and reuses its slot after all readers
/// that had called enter() by then have left. A reader that does not leave for long stops the
/// loader.
class BrickWindow {
 public:
  /// Number of hands that a window follows. Hands beyond this number share an entry with another.
  static constexpr std::size_t kMostHands = 16;

  /// Fetches the coarsest level and starts the loader. Throws VolumeError if the level cannot be
  /// fetched, or if the budget does not hold it and 27 more bricks.
  BrickWindow(std::unique_ptr<BrickSource> source, const WindowParams& params = {});
  BrickWindow(const BrickWindow&) = delete;
  BrickWindow& operator=(const BrickWindow&) = delete;
  ~BrickWindow();  ///< Stops the thread; takes as long as one fetch.

  /// Returns the manifest of the volume.
  [[nodiscard]] const BrickManifest& manifest() const noexcept { return source_->manifest(); }
  /// Returns the parameters of this window.
  [[nodiscard]] const WindowParams& params() const noexcept { return params_; }
  /// Returns the coarsest level as a volume, for display and statistics. Throws VolumeError. Slow.
  [[nodiscard]] std::shared_ptr<const Volume> coarsest() const;

  /// Returns a number for aim(), for one reader. RT: wait-free.
  [[nodiscard]] std::size_t newHand() const noexcept;
  /// Position and velocity of a hand, in index space of level 0 [voxels, voxels/s].
  struct Aim {
    Vec3 proxy = Vec3::Zero();     ///< Position of the proxy, which surfaces hold.
    Vec3 probe = Vec3::Zero();     ///< Position of the hand itself.
    Vec3 velocity = Vec3::Zero();  ///< Velocity of the probe.
  };
  /// Reports where a hand is. The caller calls it once a tick. The window stops following a hand
  /// that has not reported for a second. RT: wait-free.
  void aim(std::size_t hand, const Aim& at) const noexcept;

  /// Registers a reader. Bricks that entryAt() returns from now on stay readable until leave(). A
  /// registered reader must not call settle(). RT: no lock; repeats the count if the loader removes
  /// a brick at that moment.
  [[nodiscard]] std::uint32_t enter() const noexcept;
  /// Unregisters a reader, with the value that enter() returned. RT: wait-free.
  void leave(std::uint32_t side) const noexcept;

  /// State of a brick at one moment. RT: get it again before each reading.
  class Entry {
   public:
    /// Missing, of one value, or in a slot.
    enum Kind : std::uint32_t { kAbsent = 0, kConstant = 1, kSlot = 2 };

    Entry() = default;
    explicit Entry(std::uint64_t bits) noexcept : bits_(bits) {}  ///< From bits().
    /// @param index       Index of the slot or of the constant brick, below 2^30.
    /// @param generation  Generation of the slot; 0 for other kinds.
    Entry(Kind kind, std::uint32_t index, std::uint32_t generation) noexcept
        : bits_(std::uint64_t{generation} << 32U | std::uint64_t{index} << 2U | kind) {}
    /// Returns whether the brick is missing, of one value, or in a slot.
    [[nodiscard]] Kind kind() const noexcept { return static_cast<Kind>(bits_ & 3U); }
    [[nodiscard]] bool resident() const noexcept { return kind() != kAbsent; }  ///< It can be read.
    /// Returns the index of a slot, or of a constant brick.
    [[nodiscard]] std::uint32_t index() const noexcept {
      return static_cast<std::uint32_t>(bits_ >> 2U) & 0x3fffffffU;
    }
    /// Returns the number that a slot has as long as it holds the brick.
    [[nodiscard]] std::uint32_t generation() const noexcept {
      return static_cast<std::uint32_t>(bits_ >> 32U);
    }
    /// Returns the entry as a number.
    [[nodiscard]] std::uint64_t bits() const noexcept { return bits_; }
    /// Returns true for the same brick in the same slot.
    [[nodiscard]] bool operator==(const Entry&) const = default;

   private:
    std::uint64_t bits_ = 0;
  };

  /// Counts the bricks that arrived and left: entries are the same while this number is. RT.
  [[nodiscard]] std::uint64_t changes() const noexcept;

  /// Returns the entry of the brick with cell (i, j, k) of a level; a constant one beyond the
  /// pyramid. RT.
  [[nodiscard]] Entry entryAt(std::int32_t level, int i, int j, int k) const noexcept;

  /// Returns when the brick of a slot arrived [ns of the steady clock]. For other entries, and for
  /// a brick that arrived away from all proxies, returns a time long ago. RT.
  [[nodiscard]] std::int64_t arrival(const Entry& entry) const noexcept;

  /// 4^3 voxels: rows along the last axis, and their active bits in the order of a cell (cell.h).
  struct Cell {
    std::array<const float*, 16> rows;  ///< In the pool, or in `room`.
    std::uint64_t active = 0;           ///< One bit a voxel.
    std::array<float, 64UL * 3> room;   ///< For rows that are not in the pool in this form.
  };
  /// Reads the voxels around a cell, from one voxel before its lowest corner. The entry has to come
  /// from a call since enter(). Returns false if the brick is missing. RT: no allocation.
  [[nodiscard]] bool cellAt(const Entry& entry, std::int32_t level, const std::array<int, 3>& cell,
                            Cell& out) const noexcept;

  [[nodiscard]] WindowState state() const;  ///< Present state. Takes a lock.
  /// Returns true while the volume is lost, from one to two seconds after the loss; see
  /// BrickSource::isThere. Bricks in memory stay readable. RT: wait-free.
  [[nodiscard]] bool lost() const noexcept;
  /// Returns the errors since the last call: one line for each brick and kind of error, at most 8
  /// of a kind. One more line reports that the whole volume is lost, and one that it is back.
  [[nodiscard]] std::vector<std::string> takeTroubles() const;
  /// Waits until every requested brick has arrived or failed. Returns false if that takes more than
  /// `seconds` [s]. In virtual time the loop does not wait for disks: call this before each tick.
  /// During the wait the window keeps following its hands, even if they do not report. Cost: two
  /// loads if no request changed.
  [[nodiscard]] bool settle(double seconds) const;

 private:
  struct HandReport;
  struct Pool;
  struct Loader;

  std::unique_ptr<BrickSource> source_;
  WindowParams params_;
  std::unique_ptr<Pool> pool_;
  std::unique_ptr<Loader> loader_;
};

}  // namespace palpate
