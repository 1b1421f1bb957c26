/// The frames of a volume that is played: some of them in memory, fetched ahead of play.
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

#include "palpate/engine/field.h"
#include "palpate/samplers/vdb_field.h"
#include "palpate/samplers/volume.h"

namespace palpate {

/// When frames are.
struct FrameTimes {
  std::vector<double> times;  ///< Of the frames, ascending [s]; repeated one more, when the first
                              ///< comes again.
  bool repeat = false;        ///< After the last frame the first comes; else the last one stays.

  [[nodiscard]] bool operator==(const FrameTimes&) const = default;  ///< For the same times.
};

/// `count` frames, `rate` a second [1/s], the first at 0.
[[nodiscard]] FrameTimes evenTimes(std::size_t count, double rate, bool repeat);

/// What a sequence may take.
struct SequenceParams {
  std::uint64_t budget =
      1ULL << 30;      ///< Of the frames in memory [bytes], by the largest one's size.
  bool waits = false;  ///< A field's attend() waits for its frames, 60 s at most: for
                       ///< virtual time, where the same hand feels the same.

  [[nodiscard]] bool operator==(const SequenceParams&) const = default;  ///< For the same sequence.
};

/// What a sequence has and has done.
struct SequenceState {
  std::uint64_t frames = 0;    ///< All of them.
  std::uint64_t slots = 0;     ///< Frames that memory holds.
  std::uint64_t resident = 0;  ///< Frames in it now.
  std::uint64_t bytes = 0;     ///< Of these.
  std::uint64_t fetched = 0;   ///< Since it was opened, the first included.
  std::uint64_t failed = 0;    ///< Frames that could not be had; tried again.
};

/// A place between two frames: (1 - share) of `low`, `share` of `high`.
struct PlayMoment {
  int low = 0;            ///< A frame,
  int high = 0;           ///< and the one after it.
  double share = 0.0;     ///< 0 to 1
  double position = 0.0;  ///< `low` as it is counted on, and the share of the way [frames].

  [[nodiscard]] bool operator==(const PlayMoment&) const = default;  ///< For the same place.
};

/// Frames of one grid, placed; kept by a thread of its own, ahead of where they are played. The
/// first one is always there.
///
/// Readers are in nobody's way: a frame that one of them holds (Hold) is not let go of, and one
/// that was held within 50 ms neither.
class FrameSequence {
  struct Slot;

 public:
  /// Loads each frame once, in order, which says where all of them have data. Throws VolumeError: a
  /// frame cannot be read, is of another kind than the first, or is a vector by component; the
  /// budget does not hold five frames; times that do not ascend, or not as many as there are
  /// frames.
  FrameSequence(std::vector<VolumeRequest> frames, const FrameTimes& when,
                const Placement& placement, const Sampling& sampling,
                const SequenceParams& params = {});
  FrameSequence(const FrameSequence&) = delete;
  FrameSequence& operator=(const FrameSequence&) = delete;
  ~FrameSequence();  ///< Ends the thread: as long as a frame takes to load.

  /// The first frame,
  [[nodiscard]] const std::shared_ptr<const Volume>& first() const noexcept { return first_; }
  /// and its field.
  [[nodiscard]] const FieldPtr& firstField() const noexcept { return first_field_; }
  [[nodiscard]] const FieldFrame& frame() const noexcept { return frame_; }  ///< About all frames.
  [[nodiscard]] const FrameTimes& times() const noexcept { return when_; }   ///< As given.
  [[nodiscard]] bool waits() const noexcept { return params_.waits; }        ///< As given.

  /// Where play is at a time [s], between frames that can be had. RT: no allocation. Cost: a
  /// search.
  [[nodiscard]] PlayMoment at(double play) const noexcept PALPATE_NONBLOCKING;
  /// How far on b is from a [frames], the shorter way round where the sequence repeats. RT.
  [[nodiscard]] double way(const PlayMoment& a, const PlayMoment& b) const noexcept;

  /// A frame that is there and stays while this lives.
  class Hold {
   public:
    Hold() = default;
    /// Takes over what it holds.
    Hold(Hold&& other) noexcept : slot_(std::exchange(other.slot_, nullptr)) {}
    /// Likewise.
    Hold& operator=(Hold&& other) noexcept {
      std::swap(slot_, other.slot_);
      return *this;
    }
    ~Hold();
    /// False: it holds nothing.
    [[nodiscard]] explicit operator bool() const noexcept { return slot_ != nullptr; }
    [[nodiscard]] const FieldPtr& field() const noexcept;  ///< Of the frame.
    /// That the frame has in memory: another one after it was let go of.
    [[nodiscard]] std::uint64_t stay() const noexcept;

   private:
    friend class FrameSequence;
    explicit Hold(Slot* slot) noexcept : slot_(slot) {}
    Slot* slot_ = nullptr;
  };
  /// Empty: it is not there. RT: no lock, no allocation.
  [[nodiscard]] Hold hold(int frame) const noexcept PALPATE_NONBLOCKING;

  /// Says where play is, and how fast it goes on [s/s]: what comes next is fetched. RT: stores.
  void tell(const PlayMoment& at, double rate) const noexcept PALPATE_NONBLOCKING;
  /// Waits until the frames of these moments are there or known not to be had; false where that
  /// takes longer [s]. Not RT.
  [[nodiscard]] bool wait(std::span<const PlayMoment> moments, double seconds) const;
  /// Of those who wait for frames one at a time: what each needs at once may be all that memory
  /// holds. Not RT.
  [[nodiscard]] std::unique_lock<std::mutex> waitAlone() const;

  /// Frames that memory must hold for play at this speed [s/s] to go on, on time.
  [[nodiscard]] std::uint64_t neededFor(double speed) const noexcept;
  [[nodiscard]] SequenceState state() const;  ///< As it is now. Takes a lock.
  /// What went wrong since the last call, a line a frame, 8 at most.
  [[nodiscard]] std::vector<std::string> takeTroubles() const;

 private:
  struct Shared;
  struct Loader;

  [[nodiscard]] int count() const noexcept;
  /// The frame that a number means which is counted on over the rounds.
  [[nodiscard]] int within(int frame) const noexcept;
  /// The next frame that can be had, on (1) or back (-1); -1: there is none.
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
