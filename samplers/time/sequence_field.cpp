#include "palpate/samplers/time/sequence_field.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <new>
#include <span>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

namespace palpate {
namespace {

using Hold = FrameSequence::Hold;

/// Duration of the fade after a jump of play [s].
constexpr double kJump = 0.05;
/// Play has not jumped if the moment shown in the last tick is at most this far from the moment
/// where play was one tick ago, by its present position and rate [frames]. During a fade, the
/// distance is multiplied by the share of the shown moment.
constexpr double kLittle = 0.005;
/// Longest wait for frames in virtual time [s].
constexpr double kPatience = 60.0;
/// Largest number of attempts to hold all frames of a tick. An attempt fails, for example, if a
/// frame leaves memory before it is held.
constexpr int kTries = 1000;
/// Largest number of frames in a reading: two around the play position, and two from which the
/// reading fades.
constexpr std::size_t kFrames = 4;
/// Largest number of readers within a tick at the same time. A further reader counts as late.
constexpr std::size_t kSeats = 16;
constexpr std::size_t kNoSeat = kSeats;

struct Part {
  Hold held;
  /// Hold::stay of the frame to which the cache belongs; 0 if the cache is unused.
  std::uint64_t stay = 0;
  double weight = 0.0;  ///< Share of the frame in the blend.
  FieldCache cache;
};

/// Place for the frames that a reader reads in a tick. The caches stay valid for the reader's next
/// tick.
struct Seat {
  std::array<Part, kFrames> parts;
  std::size_t count = 0;
  std::uint64_t reader = 0;  ///< Reader to which the caches belong.
  std::atomic<bool> taken{false};
};

struct Blend {
  PlayMoment shown;      ///< Moment that is played now.
  PlayMoment left;       ///< Moment from which the reading fades, while `arrived` is below 1.
  double arrived = 1.0;  ///< Share of the moment `shown` in the reading.

  bool operator==(const Blend&) const = default;
};

struct Reading : Blend {
  std::uint64_t reader = 0;
  std::size_t seat = kNoSeat;  ///< Index of the reader's seat; kNoSeat outside of a tick.
  std::size_t last_seat = 0;
  bool met = false;   ///< True if the reader has had a tick.
  bool late = false;  ///< True if the reading does not show the requested moment.
};

static_assert(sizeof(Reading) <= sizeof(FieldCache::bytes));
static_assert(std::is_trivially_destructible_v<Reading>);

std::uint64_t nextReader() noexcept {
  static std::atomic<std::uint64_t> count{0};
  return ++count;
}

/// Does not mark the frame as a distance, because a blend of two distances is not a distance.
FieldFrame frameOf(const FrameSequence& sequence) {
  FieldFrame frame = sequence.frame();
  frame.distance = false;
  return frame;
}

template <class Base>
class SequenceField : public Base {
 public:
  explicit SequenceField(std::shared_ptr<const FrameSequence> sequence)
      : Base(frameOf(*sequence)), sequence_(std::move(sequence)), seats_(kSeats) {}

  void reset(FieldCache& memory) const noexcept final {
    auto* reading = ::new (memory.bytes.data()) Reading;
    reading->reader = nextReader();
  }
  [[nodiscard]] bool attends() const noexcept final { return true; }

  bool attend(const Attention& at, FieldCache& memory) const noexcept final {
    Reading& of = readingIn(memory);
    const Blend before = of;
    if (sequence_->waits()) {
      attendWaiting(at, of);
    } else {
      attendAtOnce(at, of);
    }
    return !(before == of);
  }

  void leave(FieldCache& memory) const noexcept final {
    Reading& of = readingIn(memory);
    if (of.seat == kNoSeat) return;
    Seat& seat = seats_[of.seat];
    for (Part& part : seat.parts) part.held = {};
    of.seat = kNoSeat;
    seat.taken.store(false, std::memory_order_release);
  }

 protected:
  using Own = std::shared_ptr<const Base>;

  [[nodiscard]] std::span<Part> partsOf(FieldCache& memory) const noexcept {
    const Reading& of = readingIn(memory);
    if (of.seat == kNoSeat) return {};
    Seat& seat = seats_[of.seat];
    return std::span(seat.parts).first(seat.count);
  }
  template <class Sample, class Derivative>
  [[nodiscard]] Sample blended(const Vec3& p_W, FieldCache& memory,
                               Derivative Sample::*derivative) const noexcept {
    Sample out;
    each(memory, [&](const Base& field, FieldCache& cache, double weight) {
      const Sample s = field.sample(p_W, cache);
      out.value += weight * s.value;
      out.*derivative += weight * (s.*derivative);
      out.inside = out.inside || s.inside;
    });
    out.coarse = out.inside && readingIn(memory).late;
    return out;
  }
  [[nodiscard]] static const Base& fieldOf(const FieldPtr& field) noexcept {
    return **std::get_if<Own>(&field);
  }

  /// Calls `read(field, cache, weight)` for each part. Without parts, calls it for the first frame.
  template <class Read>
  void each(FieldCache& memory, Read read) const noexcept {
    const std::span<Part> parts = partsOf(memory);
    for (Part& part : parts) read(fieldOf(part.held.field()), part.cache, part.weight);
    if (!parts.empty()) return;
    FieldCache own;
    const Base& first = fieldOf(sequence_->firstField());
    first.reset(own);
    read(first, own, 1.0);
  }

 private:
  struct Pair {
    Hold low;
    Hold high;  ///< Empty if the high frame has no share.
    double share = 0.0;
    bool all = false;  ///< True if all frames with a share above 0 are in memory.
  };

  void attendAtOnce(const Attention& at, Reading& of) const noexcept {
    const PlayMoment asked = sequence_->at(at.play);
    sequence_->tell(asked, at.rate);
    Pair shown = take(asked);
    goOn(of, asked, shown.all, at);
    if (of.late) shown = take(of.shown);
    sit(of, std::move(shown), of.arrived < 1.0 ? take(of.left) : Pair{});
  }

  /// Begins a tick that waits until all available frames of its moments are held at the same time.
  /// After kPatience or kTries, shows the moment without a fade, or the first frame if a frame is
  /// missing.
  void attendWaiting(const Attention& at, Reading& of) const noexcept {
    const auto alone = sequence_->waitAlone();
    const Reading before = of;
    for (int i = 0; i < kTries; ++i) {
      of = before;
      const PlayMoment asked = sequence_->at(at.play);
      sequence_->tell(asked, at.rate);
      goOn(of, asked, true, at);
      const std::array<PlayMoment, 2> needed{of.shown, of.arrived < 1.0 ? of.left : of.shown};
      if (!sequence_->wait(needed, kPatience)) break;
      // If a needed frame is missing, the requested moment now blends other frames.
      if (!of.late && !(sequence_->at(at.play) == asked)) continue;
      Pair shown = take(of.shown);
      Pair left = of.arrived < 1.0 ? take(of.left) : Pair{};
      if (!shown.all || (of.arrived < 1.0 && !left.all)) continue;
      return sit(of, std::move(shown), std::move(left));
    }
    sit(of, take(of.shown), {});
  }

  /// Sets the moment that a tick shows: `asked`, the start of a fade to `asked`, or the last
  /// moment. `there` is true if the frames of `asked` are in memory.
  void goOn(Reading& of, const PlayMoment& asked, bool there, const Attention& at) const noexcept {
    const double dt = at.dt > 0.0 ? at.dt : 0.0;
    of.arrived = std::min(of.arrived + dt / kJump, 1.0);
    const PlayMoment& shown = of.shown;
    const bool meet = (shown.low == asked.low && shown.high == asked.high) ||
                      shown.high == asked.low || shown.low == asked.high;
    const PlayMoment from = sequence_->at(at.play - at.rate * dt);
    const bool goes_on = meet && of.arrived * std::abs(sequence_->way(shown, from)) <= kLittle;
    if (there && (goes_on || !of.met)) {
      of.shown = asked;
    } else if (there && of.arrived >= 1.0) {
      of.left = std::exchange(of.shown, asked);
      of.arrived = 0.0;
    }
    // If the first requested frames arrive later, the reading fades to them from the first frame.
    of.met = true;
    of.late = !(of.shown == asked);
  }

  static Reading& readingIn(FieldCache& memory) noexcept {
    return *std::launder(reinterpret_cast<Reading*>(memory.bytes.data()));
  }

  [[nodiscard]] Pair take(const PlayMoment& at) const noexcept {
    Pair out;
    out.share = at.low == at.high ? 0.0 : at.share;
    if (out.share < 1.0) out.low = sequence_->hold(at.low);
    if (out.share > 0.0) out.high = sequence_->hold(at.high);
    out.all = (out.share >= 1.0 || out.low) && (out.share <= 0.0 || out.high);
    return out;
  }

  /// Takes a seat, and puts into it the frames of the shown moment and of the moment from which the
  /// reading fades.
  void sit(Reading& of, Pair shown, Pair left) const noexcept {
    takeSeat(of);
    if (of.seat == kNoSeat) {
      of.late = true;
      return;
    }
    Seat& seat = seats_[of.seat];
    seat.count = 0;
    if (!shown.all) {
      of.shown = {};  // a blend of the first frame alone
      of.late = true;
      return;
    }
    const double arrived = left.all ? of.arrived : 1.0;
    add(seat, std::move(shown.low), arrived * (1.0 - shown.share));
    add(seat, std::move(shown.high), arrived * shown.share);
    add(seat, std::move(left.low), (1.0 - arrived) * (1.0 - left.share));
    add(seat, std::move(left.high), (1.0 - arrived) * left.share);
  }

  /// Takes a seat for a reader: its last seat if that seat is free, else another free seat.
  void takeSeat(Reading& of) const noexcept {
    for (std::size_t n = 0; n < kSeats; ++n) {
      const std::size_t at = (of.last_seat + n) % kSeats;
      Seat& seat = seats_[at];
      if (seat.taken.exchange(true, std::memory_order_acquire)) continue;
      if (seat.reader != of.reader) {
        seat.reader = of.reader;
        for (Part& part : seat.parts) part.stay = 0;
      }
      of.seat = of.last_seat = at;
      return;
    }
  }

  void add(Seat& seat, Hold held, double weight) const noexcept {
    if (!held || !(weight > 0.0)) return;
    const std::uint64_t stay = held.stay();
    const auto begin = seat.parts.begin();
    const auto read = begin + static_cast<std::ptrdiff_t>(seat.count);
    const auto is = [stay](const Part& part) { return part.stay == stay; };
    if (const auto same = std::find_if(begin, read, is); same != read) {
      same->weight += weight;
      return;
    }
    const auto known = std::find_if(read, seat.parts.end(), is);
    if (known != seat.parts.end()) {
      swapParts(*read, *known);
    }
    Part& part = *read;
    part.held = std::move(held);
    part.weight = weight;
    if (part.stay != stay) {
      part.stay = stay;
      fieldOf(part.held.field()).reset(part.cache);
    }
    ++seat.count;
  }
  static void swapParts(Part& a, Part& b) noexcept {
    if (&a == &b) return;
    std::swap(a.cache, b.cache);
    std::swap(a.stay, b.stay);
  }

  std::shared_ptr<const FrameSequence> sequence_;
  mutable std::vector<Seat> seats_;
};

class SequenceScalar final : public SequenceField<ScalarField> {
 public:
  using SequenceField::SequenceField;

  [[nodiscard]] ScalarSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    return blended(p_W, memory, &ScalarSample::gradient);
  }
  [[nodiscard]] double value(const Vec3& p_W, FieldCache& memory) const noexcept override {
    double sum = 0.0;
    each(memory, [&](const ScalarField& field, FieldCache& cache, double weight) {
      sum += weight * field.value(p_W, cache);
    });
    return sum;
  }
  [[nodiscard]] Vec3 cellGradient(const Vec3& p_W, FieldCache& memory) const noexcept override {
    Vec3 sum = Vec3::Zero();
    each(memory, [&](const ScalarField& field, FieldCache& cache, double weight) {
      sum += weight * field.cellGradient(p_W, cache);
    });
    return sum;
  }
  [[nodiscard]] Mat3 gradientJacobian(const Vec3& p_W, FieldCache& memory) const noexcept override {
    Mat3 sum = Mat3::Zero();
    each(memory, [&](const ScalarField& field, FieldCache& cache, double weight) {
      sum += weight * field.gradientJacobian(p_W, cache);
    });
    return sum;
  }
  [[nodiscard]] Crossing firstFall(const Vec3& a_W, const Vec3& b_W, double level, double sign,
                                   FieldCache& memory) const noexcept override {
    const std::span<Part> parts = partsOf(memory);
    if (parts.size() != 1) return ScalarField::firstFall(a_W, b_W, level, sign, memory);
    return fieldOf(parts[0].held.field()).firstFall(a_W, b_W, level, sign, parts[0].cache);
  }
};

class SequenceVector final : public SequenceField<VectorField> {
 public:
  using SequenceField::SequenceField;

  [[nodiscard]] VectorSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    return blended(p_W, memory, &VectorSample::jacobian);
  }
  [[nodiscard]] Trace trace(const Vec3& p_W, const TraceOrder& order,
                            FieldCache& memory) const noexcept override {
    const std::span<Part> parts = partsOf(memory);
    if (parts.size() != 1) return VectorField::trace(p_W, order, memory);
    return fieldOf(parts[0].held.field()).trace(p_W, order, parts[0].cache);
  }
};

}  // namespace

FieldPtr makeSequenceField(std::shared_ptr<const FrameSequence> sequence) {
  if (sequence->first()->info().vector) {
    return std::make_shared<const SequenceVector>(std::move(sequence));
  }
  return std::make_shared<const SequenceScalar>(std::move(sequence));
}

}  // namespace palpate
