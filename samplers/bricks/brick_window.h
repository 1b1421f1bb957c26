/// A window of bricks: the part of a large volume that is in memory.
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

/// Parameters of a window.
struct WindowParams {
  /// Memory for the pool, the tables of bricks and one fetch [bytes]. Further connections of a
  /// remote store need more memory.
  std::uint64_t budget = 256ULL << 20;
  /// Look-ahead along a hand's path [s]. The window extends it if bricks arrive slowly.
  double horizon = 0.25;
  bool lock = true;  ///< True to lock the pool in memory, if the system permits it.
  /// If true, attend() of a field waits up to 60 s for all requested bricks, so that equal motions
  /// give equal forces in virtual time.
  bool waits = false;

  /// Returns true if all parameters are equal.
  [[nodiscard]] bool operator==(const WindowParams&) const = default;
};

/// Number of bricks in a window, and counters of its work.
struct WindowState {
  std::uint64_t slots = 0;     ///< Number of bricks for which the pool has room.
  std::uint64_t resident = 0;  ///< Number of bricks in the pool, including the coarsest level.
  /// Memory that WindowParams::budget limits: the pool, the tables and one fetch [bytes].
  std::uint64_t bytes = 0;
  std::uint64_t fetched = 0;  ///< Number of fetches of bricks so far, including those at the start.
  /// Number of bricks whose last fetch failed. Readers use a coarser level instead.
  std::uint64_t failed = 0;
  bool locked = false;  ///< True if the pool is locked in memory.
  bool gone = false;    ///< Value of BrickWindow::lost().
};

/// A pool of bricks of all levels around the hands. A loader thread fills it, first with bricks
/// near a hand or its predicted path. The whole coarsest level is always loaded.
///
/// Readers share the pool without a lock. To reuse a slot, the loader removes the slot's brick from
/// the tables, and waits until all earlier readers have left. So a reader that does not leave
/// blocks the loader.
class BrickWindow {
 public:
  /// Number of hands that a window can follow. Further hands share the records of the first hands:
  /// a record holds the last report of any of its hands.
  static constexpr std::size_t kMostHands = 16;

  /// Fetches the coarsest level and starts the loader. Throws VolumeError if the level cannot be
  /// fetched. Also throws it if the budget does not suffice for this level and 27 more bricks (or
  /// all bricks of a smaller volume), or if the pool is too large for the machine's memory.
  BrickWindow(std::unique_ptr<BrickSource> source, const WindowParams& params = {});
  BrickWindow(const BrickWindow&) = delete;
  BrickWindow& operator=(const BrickWindow&) = delete;
  ~BrickWindow();  ///< Stops the loader thread. May take as long as one fetch.

  /// Returns the manifest of the volume.
  [[nodiscard]] const BrickManifest& manifest() const noexcept { return source_->manifest(); }
  /// Returns the parameters of this window.
  [[nodiscard]] const WindowParams& params() const noexcept { return params_; }
  /// Reads the coarsest level from the source as a volume, for display and statistics. Slow. Throws
  /// VolumeError in the cases of loadBricks.
  [[nodiscard]] std::shared_ptr<const Volume> coarsest() const;

  /// Returns the number of a new hand, for use with aim(). RT: wait-free.
  [[nodiscard]] std::size_t newHand() const noexcept;
  /// Position and velocity of a hand, in index space of level 0 [voxels, voxels/s].
  struct Aim {
    Vec3 proxy = Vec3::Zero();     ///< Position of the proxy.
    Vec3 probe = Vec3::Zero();     ///< Position of the probe.
    Vec3 velocity = Vec3::Zero();  ///< Velocity of the probe.
  };
  /// Reports the position and velocity of a hand. Call it once in each tick: the loader ignores a
  /// hand that has not reported for 1 s, unless WindowParams::waits is true or a caller waits in
  /// settle(). RT: wait-free.
  void aim(std::size_t hand, const Aim& at) const noexcept;

  /// Registers a reader. Bricks from later calls of entryAt() stay readable until leave(). Until
  /// then, do not call settle(). RT: no lock; retries if the loader removes a brick.
  [[nodiscard]] std::uint32_t enter() const noexcept;
  /// Ends the registration of a reader. `side` is the value that enter() returned. RT: wait-free.
  void leave(std::uint32_t side) const noexcept;

  /// State of a brick at one moment: missing, of one value, or in a slot. Call entryAt() again
  /// before each reading, because the state may change.
  class Entry {
   public:
    /// Missing, of one value, or in a slot of the pool.
    enum Kind : std::uint32_t { kAbsent = 0, kConstant = 1, kSlot = 2 };

    Entry() = default;
    /// Makes an entry from the number that bits() returned.
    explicit Entry(std::uint64_t bits) noexcept : bits_(bits) {}
    /// @param index       Index of the slot or of the constant brick, below 2^30.
    /// @param generation  Generation of the slot; 0 for other kinds.
    Entry(Kind kind, std::uint32_t index, std::uint32_t generation) noexcept
        : bits_(std::uint64_t{generation} << 32U | std::uint64_t{index} << 2U | kind) {}
    /// Returns whether the brick is missing, of one value, or in a slot.
    [[nodiscard]] Kind kind() const noexcept { return static_cast<Kind>(bits_ & 3U); }
    /// Returns true if the brick can be read.
    [[nodiscard]] bool resident() const noexcept { return kind() != kAbsent; }
    /// Returns the index of the brick's slot, or of its value if it has only one.
    [[nodiscard]] std::uint32_t index() const noexcept {
      return static_cast<std::uint32_t>(bits_ >> 2U) & 0x3fffffffU;
    }
    /// Returns the generation of the slot, which changes when another brick is put into the slot.
    [[nodiscard]] std::uint32_t generation() const noexcept {
      return static_cast<std::uint32_t>(bits_ >> 32U);
    }
    /// Returns the entry as one number, for atomic access.
    [[nodiscard]] std::uint64_t bits() const noexcept { return bits_; }
    /// Returns true if kind, index and generation are equal. If true for kSlot, the slot still has
    /// the same brick. All missing bricks have equal entries.
    [[nodiscard]] bool operator==(const Entry&) const = default;

   private:
    std::uint64_t bits_ = 0;
  };

  /// Returns the number of changes of the tables. The number grows just after each change of an
  /// entry. RT: no lock.
  [[nodiscard]] std::uint64_t changes() const noexcept;

  /// Returns the entry of the brick that contains cell (i, j, k) of a level. The level must exist.
  /// For a cell outside of the level, returns an entry of the background. RT: no lock.
  [[nodiscard]] Entry entryAt(std::int32_t level, int i, int j, int k) const noexcept;

  /// Returns the time at which the brick in a slot arrived [ns of the steady clock]. Returns the
  /// smallest std::int64_t for other entries, and for bricks that arrived far from all proxies. RT:
  /// no lock.
  [[nodiscard]] std::int64_t arrival(const Entry& entry) const noexcept;

  /// A block of 4^3 voxels: pointers to its rows along the last axis, and its active bits in the
  /// order of a kernel's mask (cell.h).
  struct Cell {
    std::array<const float*, 16> rows;  ///< Rows in the pool, or in `room`.
    /// Bits of active voxels. In a volume of scalars, only the four inner rows have bits. In a
    /// volume of vectors, all rows have bits except the four rows at the rim along both axes. Other
    /// bits are 0. All bits of a brick of one value are equal.
    std::uint64_t active = 0;
    /// Memory for rows that the pool does not store as 32-bit floats.
    std::array<float, 64UL * 3> room;
  };
  /// Reads the block of 4^3 voxels around a cell, from one voxel before the cell's lowest corner
  /// on. `entry` must come from entryAt() after the last enter(). Returns false if the brick is
  /// missing. RT: no allocation.
  [[nodiscard]] bool cellAt(const Entry& entry, std::int32_t level, const std::array<int, 3>& cell,
                            Cell& out) const noexcept;

  [[nodiscard]] WindowState state() const;  ///< Returns the present state. Takes a lock.
  /// Returns true after two successive checks, 1 s or more apart, have not found the volume
  /// (BrickSource::isThere), until a check finds it. Bricks in memory stay readable. RT: wait-free.
  [[nodiscard]] bool lost() const noexcept;
  /// Returns the errors since the last call. The window reports each brick and kind of error once,
  /// at most 8 of a kind in all. It also reports when the whole volume is lost or available again.
  [[nodiscard]] std::vector<std::string> takeTroubles() const;
  /// Waits until every requested brick has arrived or failed. Returns false after `seconds` [s]. In
  /// virtual time, call it before each tick. Cost: three atomic loads if no request is open.
  [[nodiscard]] bool settle(double seconds) const;

 private:
  struct Pool;
  struct Loader;

  std::unique_ptr<BrickSource> source_;
  WindowParams params_;
  std::unique_ptr<Pool> pool_;
  std::unique_ptr<Loader> loader_;
};

}  // namespace palpate
