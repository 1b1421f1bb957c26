/// A window of bricks about the hands: what of a volume larger than memory is in memory.
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

#include "palpate/samplers/bricks.h"

namespace palpate {

/// What a window may take, and how far it looks ahead.
struct WindowParams {
  std::uint64_t budget = 256ULL << 20;  ///< Of pool, tables and what is being fetched [bytes].
  double horizon = 0.25;  ///< A hand's way in this time is fetched, as it goes now [s]; farther
                          ///< where bricks take long to come (BrickSource::delay).
  bool lock = true;       ///< Locks the pool in memory, where that is allowed.
  bool waits = false;     ///< A field's attend() waits until all that is wanted is there, 60 s at
                          ///< most: for virtual time, where the same hand feels the same.

  [[nodiscard]] bool operator==(const WindowParams&) const = default;  ///< For the same window.
};

/// What a window has and has done.
struct WindowState {
  std::uint64_t slots = 0;     ///< Bricks that the pool can hold.
  std::uint64_t resident = 0;  ///< Bricks in it, those of the coarsest level included.
  std::uint64_t bytes = 0;     ///< Of pool, tables and what is being fetched.
  std::uint64_t fetched = 0;   ///< Those that it began with included.
  std::uint64_t failed = 0;    ///< Bricks that could not be had: felt coarse, and tried again.
  bool locked = false;         ///< The pool stays in memory.
  bool gone = false;           ///< As lost().
};

/// A pool of bricks of all levels about the hands, kept full by a thread of its own, finest where a
/// hand is and soon will be. All of the coarsest level is always there.
///
/// One pool for any number of readers, which are never in its way. Nothing that a reader sees is
/// written over: a brick is taken out of the tables, and its slot is another's once all who were in
/// (enter()) at that time have left. Who is in for long keeps the window as it is.
class BrickWindow {
 public:
  /// So many hands are looked after at a time; of more, two share the care of one.
  static constexpr std::size_t kMostHands = 16;

  /// Fetches the coarsest level and begins. Throws VolumeError: it cannot be had, or the budget
  /// does not hold it and 27 bricks more.
  BrickWindow(std::unique_ptr<BrickSource> source, const WindowParams& params = {});
  BrickWindow(const BrickWindow&) = delete;
  BrickWindow& operator=(const BrickWindow&) = delete;
  ~BrickWindow();  ///< Ends the thread: as long as one fetch takes.

  /// Of the volume.
  [[nodiscard]] const BrickManifest& manifest() const noexcept { return source_->manifest(); }
  [[nodiscard]] const WindowParams& params() const noexcept { return params_; }  ///< As given.
  /// The coarsest level as a volume, to be looked at and measured. Throws VolumeError. Slow.
  [[nodiscard]] std::shared_ptr<const Volume> coarsest() const;

  /// A number for aim(), of one reader. RT: wait-free.
  [[nodiscard]] std::size_t newHand() const noexcept;
  /// Where a hand is, in index space of level 0 [voxels, voxels/s].
  struct Aim {
    Vec3 proxy = Vec3::Zero();     ///< What a surface holds.
    Vec3 probe = Vec3::Zero();     ///< The hand itself.
    Vec3 velocity = Vec3::Zero();  ///< Of the probe.
  };
  /// Tells where a hand is, once a tick; who has told nothing for a second is not looked after any
  /// more. RT: wait-free.
  void aim(std::size_t hand, const Aim& at) const noexcept;

  /// Counts a reader in: what entryAt() says from now on can be read until leave(). Who is in does
  /// not settle(). RT: no lock; it counts twice where the loader takes a brick away meanwhile.
  [[nodiscard]] std::uint32_t enter() const noexcept;
  /// Out again, with what enter() returned. RT: wait-free.
  void leave(std::uint32_t side) const noexcept;

  /// What is known of a brick at a moment. RT: to be asked again before each reading.
  class Entry {
   public:
    /// Not there, of one value, or in a slot.
    enum Kind : std::uint32_t { kAbsent = 0, kConstant = 1, kSlot = 2 };

    Entry() = default;
    explicit Entry(std::uint64_t bits) noexcept : bits_(bits) {}  ///< As bits() gave them.
    /// @param index       Below 2^30.
    /// @param generation  Of a slot, else 0.
    Entry(Kind kind, std::uint32_t index, std::uint32_t generation) noexcept
        : bits_(std::uint64_t{generation} << 32U | std::uint64_t{index} << 2U | kind) {}
    /// Which of the three.
    [[nodiscard]] Kind kind() const noexcept { return static_cast<Kind>(bits_ & 3U); }
    [[nodiscard]] bool resident() const noexcept { return kind() != kAbsent; }  ///< It can be read.
    /// Of a slot, or of a constant brick.
    [[nodiscard]] std::uint32_t index() const noexcept {
      return static_cast<std::uint32_t>(bits_ >> 2U) & 0x3fffffffU;
    }
    /// That a slot has as long as it holds the brick.
    [[nodiscard]] std::uint32_t generation() const noexcept {
      return static_cast<std::uint32_t>(bits_ >> 32U);
    }
    [[nodiscard]] std::uint64_t bits() const noexcept { return bits_; }  ///< All of it.
    /// For the same brick in the same slot.
    [[nodiscard]] bool operator==(const Entry&) const = default;

   private:
    std::uint64_t bits_ = 0;
  };

  /// Counts the bricks that came and went: what entryAt() says is the same while this is. RT.
  [[nodiscard]] std::uint64_t changes() const noexcept;

  /// Of the brick with the cell (i, j, k) of a level; beyond the pyramid a constant one. RT.
  [[nodiscard]] Entry entryAt(std::int32_t level, int i, int j, int k) const noexcept;

  /// When the brick of a slot came [ns of the steady clock]; of others, and of one that came where
  /// no proxy was, long ago. RT.
  [[nodiscard]] std::int64_t arrival(const Entry& entry) const noexcept;

  /// 4^3 voxels: rows along the last axis, and their active bits as a cell's are laid (cell.h).
  struct Cell {
    std::array<const float*, 16> rows;  ///< In the pool, or in `room`.
    std::uint64_t active = 0;           ///< A bit a voxel.
    std::array<float, 64UL * 3> room;   ///< For rows that are not in the pool as they are.
  };
  /// The voxels about a cell, lowest corner one before it, of a brick that was there since enter().
  /// False: it was not. RT: no allocation.
  [[nodiscard]] bool cellAt(const Entry& entry, std::int32_t level, const std::array<int, 3>& cell,
                            Cell& out) const noexcept;

  [[nodiscard]] WindowState state() const;  ///< As it is now. Takes a lock.
  /// True while the volume is not there, from one to two seconds after it has gone; see
  /// BrickSource::isThere. What is in memory is read on. RT: wait-free.
  [[nodiscard]] bool lost() const noexcept;
  /// What went wrong since the last call: a line a brick and trouble, once, 8 of a kind; and one
  /// when the whole volume has gone, and when it is back.
  [[nodiscard]] std::vector<std::string> takeTroubles() const;
  /// Waits until all that is wanted by now is there or known not to be; false where that takes
  /// longer [s]. Before each tick in virtual time, which waits for no disk. Meanwhile a hand that
  /// was looked after is, though it tells nothing. Where nothing has changed it costs two loads.
  [[nodiscard]] bool settle(double seconds) const;

 private:
  struct Told;
  struct Pool;
  struct Loader;

  std::unique_ptr<BrickSource> source_;
  WindowParams params_;
  std::unique_ptr<Pool> pool_;
  std::unique_ptr<Loader> loader_;
};

}  // namespace palpate
