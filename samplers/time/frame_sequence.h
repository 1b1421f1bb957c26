/// The frames of a volume that changes over time. Keeps some frames in memory, and loads further
/// frames before they are needed.
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
  /// Times of the frames, ascending [s]. If `repeat` is true, there is one more entry: the time at
  /// which the first frame is played again.
  std::vector<double> times;
  bool repeat = false;  ///< True if the sequence repeats; else the last frame stays.

  /// True if all times are equal.
  [[nodiscard]] bool operator==(const FrameTimes&) const = default;
};

/// Returns the times of `count` frames that follow each other at `rate` frames per second [1/s].
/// The first frame is at 0.
[[nodiscard]] FrameTimes evenTimes(std::size_t count, double rate, bool repeat);

/// Options of a sequence, and the limit of its memory.
struct SequenceParams {
  std::uint64_t budget =
      1ULL << 30;  ///< Memory for frames [bytes]; each counts with the largest size.
  /// If true, attend() of a field waits for the frames that it needs, at most 60 s. For virtual
  /// time, in which equal motions must give equal forces.
  bool waits = false;

  /// True if all options are equal.
  [[nodiscard]] bool operator==(const SequenceParams&) const = default;
};

/// Present state of a sequence, and counters.
struct SequenceState {
  std::uint64_t frames = 0;    ///< Number of all frames.
  std::uint64_t empty = 0;     ///< Number of frames in which nothing is.
  std::uint64_t slots = 0;     ///< Number of frames for which there is memory.
  std::uint64_t resident = 0;  ///< Number of frames in memory.
  std::uint64_t bytes = 0;     ///< Size of the frames in memory [bytes].
  /// Number of frames loaded so far, including those that the constructor loaded.
  std::uint64_t fetched = 0;
  std::uint64_t failed = 0;  ///< Number of frames that could not be loaded. They are tried again.
};

/// The blend of frames that is played at one time: (1 - share) of frame `low` plus `share` of frame
/// `high`.
struct PlayMoment {
  int low = 0;            ///< Index of the earlier frame.
  int high = 0;           ///< Index of the later frame.
  double share = 0.0;     ///< Share of frame `high`, 0 to 1.
  double position = 0.0;  ///< Play position [frames]. Missing frames count as well.

  /// True if all members are equal.
  [[nodiscard]] bool operator==(const PlayMoment&) const = default;
};

/// The frames of one grid with a placement. A thread of this object loads the frames before they
/// are played. The first frame is always in memory.
///
/// Readers never block the loader. The loader keeps a frame while a reader holds it (Hold). Unless
/// SequenceParams::waits is set, it also keeps the frame for 50 ms after that.
class FrameSequence {
  struct Slot;

 public:
  /// Loads each frame once, in order, to find where the frames have data. A frame whose grid is
  /// missing in its file, or has no active voxel, has the value of the background everywhere.
  /// Throws VolumeError if a frame cannot be read, if no frame has data, if a frame's type differs
  /// from that of the first frame with data, or if it is a vector of three grids. Also throws if
  /// the budget does not suffice for five frames, if the times do not ascend, or if their number
  /// does not match that of the frames.
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
  /// Frame that encloses the data of all frames, in W.
  [[nodiscard]] const FieldFrame& frame() const noexcept { return frame_; }
  /// Times of the frames.
  [[nodiscard]] const FrameTimes& times() const noexcept { return when_; }
  /// Value of SequenceParams::waits.
  [[nodiscard]] bool waits() const noexcept { return params_.waits; }

  /// Returns the blend of available frames that is played at a time [s]. RT: no allocation. Cost: a
  /// binary search.
  [[nodiscard]] PlayMoment at(double play) const noexcept PALPATE_NONBLOCKING;
  /// Returns the distance from a to b [frames], in the shorter direction if the sequence repeats.
  /// RT.
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
    /// Returns a number for the frame's present stay in memory. If the frame is loaded again, this
    /// number is different.
    [[nodiscard]] std::uint64_t stay() const noexcept;

   private:
    friend class FrameSequence;
    explicit Hold(Slot* slot) noexcept : slot_(slot) {}
    Slot* slot_ = nullptr;
  };
  /// Holds a frame. The result is empty if the frame is not in memory. RT: no lock, no allocation.
  [[nodiscard]] Hold hold(int frame) const noexcept PALPATE_NONBLOCKING;

  /// Reports the play position and its rate [s/s] to the loader. RT: atomic stores only.
  void tell(const PlayMoment& at, double rate) const noexcept PALPATE_NONBLOCKING;
  /// Waits until all frames of these moments are in memory or known to be unavailable. Returns
  /// false if that takes longer than `seconds` [s]. Not RT.
  [[nodiscard]] bool wait(std::span<const PlayMoment> moments, double seconds) const;
  /// Returns a lock that a caller must hold while it waits for frames. Callers wait one at a time,
  /// because the frames that one caller needs may fill the whole memory. Not RT.
  [[nodiscard]] std::unique_lock<std::mutex> waitAlone() const;

  /// Returns the number of frames that memory must hold so that play at this speed [s/s] is not
  /// interrupted.
  [[nodiscard]] std::uint64_t neededFor(double speed) const noexcept;
  [[nodiscard]] SequenceState state() const;  ///< Returns the present state. Takes a lock.
  /// Returns the errors since the last call, one line for each frame. At most 8 lines are returned
  /// in the sequence's life.
  [[nodiscard]] std::vector<std::string> takeTroubles() const;

 private:
  struct Shared;
  struct Loader;

  [[nodiscard]] int count() const noexcept;
  /// Returns the index of a frame from a number that continues to count when the sequence repeats.
  [[nodiscard]] int within(int frame) const noexcept;
  /// Returns the next available frame, beginning at `frame`, in the direction `way`: 1 forward, -1
  /// backward. Returns -1 if there is none.
  [[nodiscard]] int good(int frame, int way) const noexcept;

  std::vector<VolumeRequest> frames_;
  FrameTimes when_;
  SequenceParams params_;
  std::shared_ptr<const Volume> first_;
  FieldPtr first_field_;
  std::uint64_t empty_ = 0;
  FieldFrame frame_;
  std::unique_ptr<Shared> shared_;
  std::unique_ptr<Loader> loader_;
};

}  // namespace palpate
