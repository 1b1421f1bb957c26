/// Frames of a volume that changes over time, loaded before they are needed.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "palpate/engine/field/field.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Times of the frames of a sequence.
struct FrameTimes {
  /// Times of the frames, ascending [s]; if `repeat`, also the time at which the first frame
  /// returns.
  std::vector<double> times;
  bool repeat = false;  ///< True if the sequence repeats; else the last frame stays.

  /// Returns the signed distance in time [s] from `play` [s] to the same share of the next interval
  /// between two frames, or of the previous interval if `forward` is false. If there is no such
  /// interval, returns the distance to the sequence's end in that direction. If `play` is outside
  /// of the sequence, returns the distance to the nearer end, or 0 if this end is in the other
  /// direction. Returns 0 if `play` is not finite.
  [[nodiscard]] double stepFrom(double play, bool forward) const noexcept;
  /// Returns true if all times are equal.
  [[nodiscard]] bool operator==(const FrameTimes&) const = default;
};

/// Returns the times of `count` frames at `rate` frames per second, `rate` > 0. The first frame is
/// at 0.
[[nodiscard]] FrameTimes evenTimes(std::size_t count, double rate, bool repeat);

/// Options of a sequence.
struct SequenceParams {
  /// Memory for frames [bytes]. Each frame counts as much as the largest frame.
  std::uint64_t budget = 1ULL << 30;
  /// If true, attend() of a field waits for its frames, up to 60 s for each attempt to get them, so
  /// that equal motions give equal forces in virtual time.
  bool waits = false;

  /// Returns true if all options are equal.
  [[nodiscard]] bool operator==(const SequenceParams&) const = default;
};

/// Present state of a sequence, and counters.
struct SequenceState {
  std::uint64_t frames = 0;    ///< Number of all frames.
  std::uint64_t empty = 0;     ///< Number of frames without data.
  std::uint64_t slots = 0;     ///< Number of frames for which there is memory.
  std::uint64_t resident = 0;  ///< Number of frames in memory.
  std::uint64_t bytes = 0;     ///< Size of the frames in memory [bytes].
  /// Number of loads of frames so far, including those of the constructor.
  std::uint64_t fetched = 0;
  /// Number of frames whose last load failed. The loader tries them again.
  std::uint64_t failed = 0;
};

/// Blend of frames at one time: (1 - share) of frame `low` plus `share` of frame `high`.
struct PlayMoment {
  int low = 0;            ///< Index of the earlier frame.
  int high = 0;           ///< Index of the later frame.
  double share = 0.0;     ///< Share of frame `high`, 0 to 1.
  double position = 0.0;  ///< Play position [frames]. Missing frames count as well.

  /// Returns true if all members are equal.
  [[nodiscard]] bool operator==(const PlayMoment&) const = default;
};

/// The frames of one grid with a placement. A thread of this object loads frames before they are
/// played. The first frame is always in memory. A reader holds a frame without a lock. The loader
/// keeps a frame while a Hold exists, and for 50 ms after that unless SequenceParams::waits is set.
class FrameSequence {
  struct Slot;

 public:
  /// Loads all frames, in order, to find where they have data. A frame without the grid or without
  /// an active voxel is background everywhere. Throws VolumeError if a frame cannot be read, is
  /// staggered or is a vector of three grids, or if no frame has data. Also throws VolumeError if
  /// scalars and vectors are mixed, if grid classes differ (the class unknown counts as fog), or
  /// for `axial`. Also throws it if the memory budget is too small for five frames, or for all of
  /// fewer frames, or if the times are not finite, do not ascend or do not match the number of
  /// frames.
  FrameSequence(std::vector<VolumeRequest> frames, const FrameTimes& when,
                const Placement& placement, const Sampling& sampling,
                const SequenceParams& params = {});
  FrameSequence(const FrameSequence&) = delete;
  FrameSequence& operator=(const FrameSequence&) = delete;
  ~FrameSequence();  ///< Ends the thread. May take as long as loading a frame.

  /// Returns the first frame that has data.
  [[nodiscard]] const std::shared_ptr<const Volume>& first() const noexcept { return first_; }
  /// Returns the field of the first frame.
  [[nodiscard]] const FieldPtr& firstField() const noexcept { return first_field_; }
  /// Returns the FieldFrame that encloses the data of all frames, in W.
  [[nodiscard]] const FieldFrame& frame() const noexcept { return frame_; }
  /// Returns the times of the frames.
  [[nodiscard]] const FrameTimes& times() const noexcept { return when_; }
  /// Returns the names of the first frames without data, at most 3, with the reason.
  [[nodiscard]] const std::vector<std::string>& firstEmpty() const noexcept { return first_empty_; }
  /// Returns SequenceParams::waits.
  [[nodiscard]] bool waits() const noexcept { return params_.waits; }

  /// Returns the blend of available frames at a time [s]; the first frame if the time is not
  /// finite. RT: no allocation. Cost: a binary search, and a step for each missing frame nearby.
  [[nodiscard]] PlayMoment at(double play) const noexcept PALPATE_NONBLOCKING;
  /// Returns the signed distance from a to b [frames], positive forward. If the sequence repeats,
  /// returns the shorter of the two distances. RT.
  [[nodiscard]] double way(const PlayMoment& a, const PlayMoment& b) const noexcept;

  /// Keeps a frame in memory while the object lives.
  class Hold {
   public:
    Hold() = default;
    /// Takes over the frame of `other`.
    Hold(Hold&& other) noexcept : slot_(std::exchange(other.slot_, nullptr)) {}
    /// Exchanges frames with `other`.
    Hold& operator=(Hold&& other) noexcept {
      std::swap(slot_, other.slot_);
      return *this;
    }
    ~Hold();
    /// Returns true if the object holds a frame.
    [[nodiscard]] explicit operator bool() const noexcept { return slot_ != nullptr; }
    [[nodiscard]] const FieldPtr& field() const noexcept;  ///< Returns the field of the frame.
    /// Returns a number that changes when the frame is loaded again.
    [[nodiscard]] std::uint64_t stay() const noexcept;

   private:
    friend class FrameSequence;
    explicit Hold(Slot* slot) noexcept : slot_(slot) {}
    Slot* slot_ = nullptr;
  };
  /// Holds a frame. The result is empty if the frame is not in memory. RT: no lock, no allocation.
  [[nodiscard]] Hold hold(int frame) const noexcept PALPATE_NONBLOCKING;

  /// Reports the play position and its rate [s/s] to the loader. With rate 0, the loader keeps the
  /// last direction. RT: atomic stores only.
  void tell(const PlayMoment& at, double rate) const noexcept PALPATE_NONBLOCKING;
  /// Waits until every frame of these moments is in memory or its load has failed. Returns false
  /// after `seconds` [s]. Not RT.
  [[nodiscard]] bool wait(std::span<const PlayMoment> moments, double seconds) const;
  /// Returns a lock that a caller must hold while it waits for frames. Callers wait one at a time,
  /// because the frames that one caller needs may fill the whole memory. Not RT.
  [[nodiscard]] std::unique_lock<std::mutex> waitAlone() const;

  /// Returns the number of frames in memory that uninterrupted play needs.
  /// @param speed  Speed of play [s/s], >= 0.
  [[nodiscard]] std::uint64_t neededFor(double speed) const noexcept;
  [[nodiscard]] SequenceState state() const;  ///< Returns the present state. Takes a lock.
  /// Returns the errors since the last call, a line for each frame that began to fail. A sequence
  /// reports at most 8 lines in all.
  [[nodiscard]] std::vector<std::string> takeTroubles() const;

 private:
  struct Shared;
  struct Loader;

  [[nodiscard]] int count() const noexcept;
  /// Returns the index of a frame from a number that continues to count when the sequence repeats.
  [[nodiscard]] int within(int frame) const noexcept;
  /// Returns the next available frame from `frame` on, in direction `way` (1 or -1); -1 if there is
  /// none. If the sequence repeats, the result may be outside of 0 to count() - 1, as for within().
  [[nodiscard]] int good(int frame, int way) const noexcept;

  std::vector<VolumeRequest> frames_;
  FrameTimes when_;
  SequenceParams params_;
  std::shared_ptr<const Volume> first_;
  FieldPtr first_field_;
  std::uint64_t empty_ = 0;
  std::vector<std::string> first_empty_;
  FieldFrame frame_;
  std::unique_ptr<Shared> shared_;
  std::unique_ptr<Loader> loader_;
};

}  // namespace palpate
