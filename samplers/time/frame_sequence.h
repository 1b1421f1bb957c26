/// The frames of a volume that is played: keeps some in memory, loaded ahead of play.
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

/// Times of frames.
struct FrameTimes {
  std::vector<double> times;  ///< Times of the frames, ascending [s]. With `repeat` one more, at
                              ///< which the first frame returns.
  bool repeat = false;        ///< The first frame follows the last; else the last frame stays.

  [[nodiscard]] bool operator==(const FrameTimes&) const = default;  ///< True for the same times.
};

/// Returns the times of `count` frames, `rate` a second [1/s], the first at 0.
[[nodiscard]] FrameTimes evenTimes(std::size_t count, double rate, bool repeat);

/// Limits and options of a sequence.
struct SequenceParams {
  std::uint64_t budget =
      1ULL << 30;      ///< Memory for frames [bytes], counted by the largest frame's size.
  bool waits = false;  ///< A field's attend() waits for its frames, 60 s at most. For virtual time,
                       ///< in which equal motions must give equal forces.

  [[nodiscard]] bool operator==(const SequenceParams&) const = default;  ///< True for the same
                                                                         ///< options.
};

/// State and statistics of a sequence.
struct SequenceState {
  std::uint64_t frames = 0;    ///< All frames.
  std::uint64_t slots = 0;     ///< Frames that memory can hold.
  std::uint64_t resident = 0;  ///< Frames in memory now.
  std::uint64_t bytes = 0;     ///< Size of the frames in memory.
  std::uint64_t fetched = 0;   ///< Frames loaded so far, including the first pass.
  std::uint64_t failed = 0;    ///< Frames that could not be loaded; retried.
};

/// A place between two frames: (1 - share) of `low`, `share` of `high`.
struct PlayMoment {
  int low = 0;            ///< A frame.
  int high = 0;           ///< The frame after it.
  double share = 0.0;     ///< 0 to 1
  double position = 0.0;  ///< Position of play, missing frames counted too [frames].

  [[nodiscard]] bool operator==(const PlayMoment&) const = default;  ///< True for the same place.
};

/// The frames of one grid, placed. A thread of its own loads them ahead of play. The first frame is
/// always in memory.
///
/// Readers never block the loader. The loader keeps a frame that a reader holds (Hold), or, unless
/// SequenceParams::waits, has held within the last 50 ms.
class FrameSequence {
  struct Slot;

 public:
  /// Loads each frame once, in order, to find where the frames have data. Throws VolumeError if a
  /// frame cannot be read, is of another kind than the first, or is a vector by component. Also
  /// throws if the budget does not hold five frames, and for times that do not ascend or differ in
  /// number from the frames.
  FrameSequence(std::vector<VolumeRequest> frames, const FrameTimes& when,
                const Placement& placement, const Sampling& sampling,
                const SequenceParams& params = {});
  FrameSequence(const FrameSequence&) = delete;
  FrameSequence& operator=(const FrameSequence&) = delete;
  ~FrameSequence();  ///< Ends the thread: takes as long as a frame takes to load.

  /// Returns the first frame.
  [[nodiscard]] const std::shared_ptr<const Volume>& first() const noexcept { return first_; }
  /// Returns the field of the first frame.
  [[nodiscard]] const FieldPtr& firstField() const noexcept { return first_field_; }
  [[nodiscard]] const FieldFrame& frame() const noexcept { return frame_; }  ///< For all frames.
  [[nodiscard]] const FrameTimes& times() const noexcept { return when_; }   ///< Frame times.
  [[nodiscard]] bool waits() const noexcept { return params_.waits; }        ///< Waits in attend().

  /// Returns the blend of loadable frames that is played at a time [s]. RT: no allocation. Cost: a
  /// search.
  [[nodiscard]] PlayMoment at(double play) const noexcept PALPATE_NONBLOCKING;
  /// Returns how far b is after a [frames], by the shorter way round if the sequence repeats. RT.
  [[nodiscard]] double way(const PlayMoment& a, const PlayMoment& b) const noexcept;

  /// A frame in memory, which stays there while this object lives.
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
    /// Returns whether it holds a frame.
    [[nodiscard]] explicit operator bool() const noexcept { return slot_ != nullptr; }
    [[nodiscard]] const FieldPtr& field() const noexcept;  ///< Field of the frame.
    /// Returns the number of the frame's stay in memory; another load of the frame has another
    /// number.
    [[nodiscard]] std::uint64_t stay() const noexcept;

   private:
    friend class FrameSequence;
    explicit Hold(Slot* slot) noexcept : slot_(slot) {}
    Slot* slot_ = nullptr;
  };
  /// Holds a frame; the result is empty if the frame is not in memory. RT: no lock, no allocation.
  [[nodiscard]] Hold hold(int frame) const noexcept PALPATE_NONBLOCKING;

  /// Sets the play position and its rate [s/s], by which the thread loads frames. RT: stores.
  void tell(const PlayMoment& at, double rate) const noexcept PALPATE_NONBLOCKING;
  /// Waits until each frame of these moments is in memory or known to be unavailable. Returns
  /// false if that takes longer than `seconds` [s]. Not RT.
  [[nodiscard]] bool wait(std::span<const PlayMoment> moments, double seconds) const;
  /// Returns a lock with which callers wait for frames one at a time: the frames that one caller
  /// needs at once may fill all memory. Not RT.
  [[nodiscard]] std::unique_lock<std::mutex> waitAlone() const;

  /// Returns how many frames memory must hold so that play at this speed [s/s] continues on time.
  [[nodiscard]] std::uint64_t neededFor(double speed) const noexcept;
  [[nodiscard]] SequenceState state() const;  ///< Current state; takes a lock.
  /// Returns the errors since the last call, a line per frame; 8 lines at most in the sequence's
  /// life.
  [[nodiscard]] std::vector<std::string> takeTroubles() const;

 private:
  struct Shared;
  struct Loader;

  [[nodiscard]] int count() const noexcept;
  /// Returns the frame for a number that continues to count over the repeats.
  [[nodiscard]] int within(int frame) const noexcept;
  /// Returns the next available frame from `frame` on, forward (1) or back (-1); -1 if all are
  /// missing.
  [[nodiscard]] int good(int frame, int way) const noexcept;

  std::vector<VolumeRequest> frames_;
  FrameTimes when_;
  SequenceParams params_;
  std::shared_ptr<const Volume> first_;
  FieldPtr first_field_;
  FieldFrame frame_;
  std::unique_ptr<Shared> shared_;
  std::unique_ptr<Loader> loader_;
};

}  // namespace palpate
