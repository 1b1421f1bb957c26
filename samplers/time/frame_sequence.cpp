#include "palpate/samplers/time/frame_sequence.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <exception>
#include <limits>
#include <map>
#include <mutex>
#include <new>
#include <optional>
#include <thread>
#include <type_traits>
#include <utility>
#include <variant>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/no_data_error.h"
#include "palpate/samplers/grid/prepare.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "palpate/samplers/retries.h"
#include "palpate/samplers/time/first_frame.h"

namespace palpate {
namespace {

using Clock = std::chrono::steady_clock;

/// Bit of Slot::users that closes a slot to readers, so that the loader can fill it.
constexpr std::uint32_t kClosed = 1U << 31U;
/// Time for which the loader keeps a frame after a reader has held it, for the reader's next tick.
constexpr std::chrono::milliseconds kKept{50};
/// Fewest frames in memory: the two around the play position, the two of the moment from which a
/// reading fades after a jump of play, and the first frame.
constexpr std::uint64_t kLeastFrames = 5;
/// Period at which the thread checks the play position.
constexpr std::chrono::milliseconds kPoll{2};
/// Largest number of error messages of a sequence.
constexpr int kMostTroubles = 8;

std::int64_t nowNs() noexcept {
  return Clock::now().time_since_epoch() / std::chrono::nanoseconds(1);
}

struct Loaded {
  std::shared_ptr<const Volume> volume;
  FieldPtr field;
  std::string why_empty;  ///< The frame's name and the reason why it has no data.
};

std::shared_ptr<const Volume> emptyLike(const Volume& first) {
  const openvdb::GridBase::Ptr grid = std::visit(
      [](const auto& like) -> openvdb::GridBase::Ptr {
        using GridT = std::remove_const_t<typename std::decay_t<decltype(like)>::element_type>;
        auto made = GridT::create(like->background());
        made->setTransform(like->transform().copy());
        made->setGridClass(like->getGridClass());
        return made;
      },
      first.grid().parts.front().data);
  Prepared prepared = prepare(first.info().name, grid, {});
  return std::make_shared<Volume>(std::move(prepared.info), std::move(prepared.grid));
}

bool isEmpty(const Loaded& frame) {
  return frame.volume->info().active_voxels == 0;
}

/// Returns the name of a frame for messages: its file, and its grid if the request names one.
std::string nameOf(const VolumeRequest& frame) {
  const std::string file = frame.file.string();
  return frame.grid.empty() ? file : file + ": grid \"" + frame.grid + "\"";
}

/// Loads a frame. Throws VolumeError if the frame cannot be read, or does not match `first`, the
/// first frame with data. A frame without data becomes background; if `first` is null, throws
/// NoDataError.
Loaded loadFrame(const VolumeRequest& request, const Placement& placement, const Sampling& sampling,
                 const Volume* first) {
  LoadOptions options;
  options.non_finite = request.non_finite;
  options.smooth = request.smooth;
  Loaded out;
  try {
    out.volume = loadVolume(request.file, request.grid, options);
  } catch (const NoDataError& e) {
    if (first == nullptr) throw;
    const std::string file = request.file.string();
    const std::string subject = e.subject();
    out.why_empty =
        (subject.starts_with(file) ? subject : file + ": " + subject) + ": " + e.reason();
    out.volume = emptyLike(*first);
  }
  const GridInfo& is = out.volume->info();
  const GridInfo& like = first != nullptr ? first->info() : is;
  // A grid without a class is read like a fog.
  const auto read_as = [](const GridInfo& of) {
    return of.grid_class == GridClass::kUnknown ? GridClass::kFog : of.grid_class;
  };
  if (is.vector != like.vector || read_as(is) != read_as(like)) {
    const auto kind = [](const GridInfo& of) { return of.type + ", " + wordFor(of.grid_class); };
    throw VolumeError(nameOf(request),
                      "the frame is of another kind (" + kind(is) +
                          ") than the first one with data (" + kind(like) + ")",
                      is.vector != like.vector
                          ? "give frames of one type"
                          : std::string("give frames of one kind, or, if only the class is wrong, "
                                        "set the grid class of all frames to \"") +
                                wordFor(like.grid_class) + "\"");
  }
  if (out.volume->grid().parts.size() > 1) {
    throw VolumeError(nameOf(request),
                      "a vector that is staggered, or whose components are separate grids, cannot "
                      "be played",
                      "write it as one grid of vectors at the voxels' centres");
  }
  out.field = makeVdbField(out.volume, placement, sampling);
  return out;
}

/// Returns the number of frames of the largest size that fit into the budget. Throws VolumeError if
/// this number is too small.
std::size_t slotsFor(std::uint64_t largest, std::size_t frames, std::uint64_t budget,
                     const std::string& name) {
  const std::uint64_t bytes = std::max<std::uint64_t>(largest, 1);
  const std::uint64_t slots = std::min<std::uint64_t>(frames, budget / bytes);
  const std::uint64_t least = std::min<std::uint64_t>(frames, kLeastFrames);
  if (slots < least) {
    constexpr double kHundredth = 1024.0 * 1024.0 / 100.0;
    const auto mebibytes = [](double of) {
      const std::string text = std::to_string(of / (1024.0 * 1024.0));
      return text.substr(0, text.find('.') + 3) + " MiB";
    };
    throw VolumeError(
        name,
        "a budget of " + mebibytes(static_cast<double>(budget)) + " holds " +
            std::to_string(slots) + " of its frames",
        "increase the budget (\"budget_mb\" of \"frames\") to " +
            mebibytes(std::ceil(static_cast<double>(least * bytes) / kHundredth) * kHundredth) +
            " or more");
  }
  return static_cast<std::size_t>(slots);
}

const FieldFrame& frameOf(const FieldPtr& field) {
  return std::visit([](const auto& of) -> const FieldFrame& { return of->frame(); }, field);
}

void checkTimes(const FrameTimes& when, std::size_t count, const std::string& name) {
  const std::size_t asked = count + (when.repeat ? 1 : 0);
  if (when.times.size() != asked) {
    throw VolumeError(
        name,
        "it has " + std::to_string(count) + " frames and " + std::to_string(when.times.size()) +
            " times",
        "give " + std::to_string(asked) +
            (when.repeat ? ": one for each frame, and one for the return of the first frame"
                         : ": one for each frame"));
  }
  for (std::size_t i = 0; i < asked; ++i) {
    const bool good = std::isfinite(when.times[i]) && (i == 0 || when.times[i] > when.times[i - 1]);
    if (good) continue;
    throw VolumeError(name,
                      "its frame time " + std::to_string(i) + " (counted from 0) is " +
                          std::to_string(when.times[i]) + " s, not " +
                          (std::isfinite(when.times[i]) ? "after the time before" : "finite"),
                      "give ascending times in seconds");
  }
  if (!std::isfinite(when.times.back() - when.times.front())) {
    throw VolumeError(name, "its times are too far apart", "give the times in seconds");
  }
}

}  // namespace

double FrameTimes::stepFrom(double play, bool forward) const noexcept {
  if (times.size() < 2 || !std::isfinite(play)) return 0.0;
  const double first = times.front();
  const double length = times.back() - first;
  double at = play;
  if (repeat) at -= length * std::floor((play - first) / length);
  if (at < first) return forward ? first - at : 0.0;
  if (at > times.back()) return forward ? 0.0 : times.back() - at;
  const auto after = std::upper_bound(times.begin() + 1, times.end() - 1, at);
  const auto last = static_cast<std::ptrdiff_t>(times.size()) - 2;  // index of the last interval
  const auto begin_of = [&](std::ptrdiff_t i) { return times[static_cast<std::size_t>(i)]; };
  const auto length_of = [&](std::ptrdiff_t i) { return begin_of(i + 1) - begin_of(i); };
  const std::ptrdiff_t here = after - times.begin() - 1;
  const double share = (at - begin_of(here)) / length_of(here);
  const std::ptrdiff_t next = here + (forward ? 1 : -1);
  if (next > last) {
    return times.back() - at + (repeat ? share * length_of(0) : 0.0);
  }
  if (next < 0) return first - at - (repeat ? (1.0 - share) * length_of(last) : 0.0);
  return begin_of(next) + share * length_of(next) - at;
}

FrameTimes evenTimes(std::size_t count, double rate, bool repeat) {
  FrameTimes out;
  out.repeat = repeat;
  for (std::size_t i = 0; i < count + (repeat ? 1 : 0); ++i) {
    out.times.push_back(static_cast<double>(i) / rate);
  }
  return out;
}

/// Memory for one frame. `users` counts its readers. The loader closes a slot to fill it.
struct FrameSequence::Slot {
  std::atomic<std::uint32_t> users{kClosed};
  std::atomic<int> frame{-1};
  std::atomic<std::int64_t> held{0};  ///< Time at which a reader last held the frame [ns].
  std::atomic<std::uint64_t> stay{0};
  std::atomic<std::uint64_t> bytes{0};
  // Only the thread that has closed the slot writes this member. Only readers that `users` counts
  // may read it.
  Loaded loaded;
};

struct FrameSequence::Shared {
  Shared(std::size_t frames, std::size_t room) : slots(room), places(frames), missing(frames) {
    for (auto& place : places) place.store(-1, std::memory_order_relaxed);
    for (auto& none : missing) none.store(false, std::memory_order_relaxed);
  }
  [[nodiscard]] bool resident(int frame) const noexcept {
    return places[static_cast<std::size_t>(frame)].load(std::memory_order_acquire) >= 0;
  }

  std::vector<Slot> slots;
  std::vector<std::atomic<int>> places;    ///< For each frame, the index of its slot, or -1.
  std::vector<std::atomic<bool>> missing;  ///< For each frame, true if it could not be loaded.
  std::atomic<int> low{0};                 ///< Play is between the frames `low` and `high`.
  std::atomic<int> high{0};
  std::atomic<int> way{1};  ///< Direction of play: 1 forward, -1 backward.
};

struct FrameSequence::Loader {
  Loader(const FrameSequence& sequence, const Placement& at, const Sampling& as)
      : of(sequence), shared(*sequence.shared_), placement(at), sampling(as) {}
  ~Loader() {
    {
      const std::lock_guard lock(mutex);
      stop = true;
    }
    changed.notify_all();
    if (thread.joinable()) thread.join();
  }

  void begin() {
    thread = std::thread([this] { run(); });
  }
  void publish(int frame, std::size_t slot, Loaded loaded) {
    Slot& to = shared.slots[slot];
    to.loaded = std::move(loaded);
    to.bytes.store(to.loaded.volume->memory(), std::memory_order_relaxed);
    to.frame.store(frame, std::memory_order_relaxed);
    to.held.store(0, std::memory_order_relaxed);
    to.stay.store(++stays, std::memory_order_relaxed);
    to.users.fetch_and(~kClosed, std::memory_order_release);
    shared.places[static_cast<std::size_t>(frame)].store(static_cast<int>(slot),
                                                         std::memory_order_release);
  }
  void run();
  [[nodiscard]] std::vector<int> wanted();
  [[nodiscard]] std::optional<std::size_t> slotFor(const std::vector<int>& all);
  void fetch(int frame, std::size_t slot);

  const FrameSequence& of;
  Shared& shared;
  Placement placement;
  Sampling sampling;
  std::uint64_t stays = 0;

  mutable std::mutex alone;  ///< Lock that waitAlone() returns.
  /// Guards the members below. It is not locked while a frame is loaded.
  mutable std::mutex mutex;
  mutable std::condition_variable changed;
  mutable std::map<int, int> asked;  ///< For each frame, the number of callers that wait for it.
  detail::Retries<int> failing;
  mutable std::vector<std::string> troubles;
  int lines = 0;
  std::uint64_t fetched = 0;
  bool stop = false;
  std::thread thread;
};

/// Returns the frames that should be in memory, the most urgent first, frames to retry last.
std::vector<int> FrameSequence::Loader::wanted() {
  const int count = of.count();
  std::vector<int> all;
  const auto want = [&](int frame) {
    if (std::find(all.begin(), all.end(), frame) == all.end()) all.push_back(frame);
  };
  for (const auto& [frame, by] : asked) want(frame);
  const int low = shared.low.load(std::memory_order_relaxed);
  const int high = shared.high.load(std::memory_order_relaxed);
  want(low);
  want(high);
  const int way = shared.way.load(std::memory_order_relaxed);
  std::vector<int> again;
  for (int i = 0; i < count && all.size() + 1 < shared.slots.size(); ++i) {
    int frame = (way > 0 ? low : high) + way * i;
    if (of.when_.repeat) {
      frame = of.within(frame);
    } else if (frame < 0 || frame >= count) {
      break;
    }
    if (shared.missing[static_cast<std::size_t>(frame)].load(std::memory_order_relaxed)) {
      again.push_back(frame);
    } else {
      want(frame);
    }
  }
  for (const int frame : again) want(frame);
  return all;
}

/// Closes a slot for a new frame and returns its index; std::nullopt if all slots have wanted
/// frames, or frames that readers hold or have held within the last kKept.
std::optional<std::size_t> FrameSequence::Loader::slotFor(const std::vector<int>& all) {
  const std::int64_t now = nowNs();
  for (std::size_t n = 0; n < shared.slots.size(); ++n) {
    Slot& slot = shared.slots[n];
    const int frame = slot.frame.load(std::memory_order_relaxed);
    if (frame < 0) return n;  // the slot is empty and already closed
    if (frame == 0 || std::find(all.begin(), all.end(), frame) != all.end()) continue;
    const bool kept =
        now - slot.held.load(std::memory_order_relaxed) < std::chrono::nanoseconds(kKept).count();
    if (kept && !of.params_.waits) continue;
    std::uint32_t nobody = 0;
    if (!slot.users.compare_exchange_strong(nobody, kClosed, std::memory_order_acq_rel)) continue;
    shared.places[static_cast<std::size_t>(frame)].store(-1, std::memory_order_release);
    slot.frame.store(-1, std::memory_order_relaxed);
    slot.loaded = {};
    return n;
  }
  return std::nullopt;
}

void FrameSequence::Loader::fetch(int frame, std::size_t slot) {
  std::string why;
  try {
    publish(frame, slot,
            loadFrame(of.frames_[static_cast<std::size_t>(frame)], placement, sampling,
                      of.first_.get()));
    shared.missing[static_cast<std::size_t>(frame)].store(false, std::memory_order_release);
  } catch (const std::bad_alloc&) {
    why = nameOf(of.frames_[static_cast<std::size_t>(frame)]) +
          ": the system has too little memory: end other programs to free memory";
  } catch (const std::exception& e) {
    why = e.what();
  }
  const std::lock_guard lock(mutex);
  if (why.empty()) {
    ++fetched;
    failing.had(frame);
  } else {
    const bool first = failing.failed(frame, Clock::now());
    shared.missing[static_cast<std::size_t>(frame)].store(true, std::memory_order_release);
    if (first && ++lines <= kMostTroubles) {
      why += ": play continues without the frame";
      if (lines == kMostTroubles) why += "; further errors are only counted";
      troubles.push_back(std::move(why));
    }
  }
  changed.notify_all();
}

void FrameSequence::Loader::run() {
  std::unique_lock lock(mutex);
  while (!stop) {
    const std::vector<int> all = wanted();
    const Clock::time_point now = Clock::now();
    const auto next = std::find_if(all.begin(), all.end(), [&](int frame) {
      return !shared.resident(frame) && failing.may(frame, now);
    });
    const auto slot = next == all.end() ? std::nullopt : slotFor(all);
    if (!slot) {
      changed.wait_for(lock, kPoll);
      continue;
    }
    lock.unlock();
    fetch(*next, *slot);
    lock.lock();
  }
}

FrameSequence::FrameSequence(std::vector<VolumeRequest> frames, const FrameTimes& when,
                             const Placement& placement, const Sampling& sampling,
                             const SequenceParams& params)
    : frames_(std::move(frames)), when_(when), params_(params) {
  if (frames_.empty())
    throw VolumeError("sequence", "it does not have a frame", "give one or more frames");
  const std::string name = frames_.front().file.string();
  checkTimes(when_, frames_.size(), name);
  if (sampling.axial) {
    throw VolumeError(name, "axial vectors of two frames cannot be blended",
                      "give one frame as \"file\", without \"frames\", or remove \"axial\" if the "
                      "signs of its vectors matter");
  }
  std::vector<Loaded> kept;
  std::uint64_t held = 0;
  std::uint64_t largest = 0;
  auto [begin, begun] = firstWithData(frames_, [&](const VolumeRequest& frame) {
    return loadFrame(frame, placement, sampling, nullptr);
  });
  first_ = begun.volume;
  frame_ = frameOf(begun.field);
  for (std::size_t i = 0; i < frames_.size(); ++i) {
    Loaded next = i == begin ? std::exchange(begun, {})
                             : loadFrame(frames_[i], placement, sampling, first_.get());
    if (i == 0) first_field_ = next.field;
    if (isEmpty(next)) {
      constexpr std::size_t kMostNamed = 3;
      ++empty_;
      if (first_empty_.size() < kMostNamed) first_empty_.push_back(next.why_empty);
    } else {
      const FieldFrame& frame = frameOf(next.field);
      frame_.bounds.extend(frame.bounds.lower);
      frame_.bounds.extend(frame.bounds.upper);
      frame_.voxel = std::min(frame_.voxel, frame.voxel);
    }
    const std::uint64_t bytes = next.volume->memory();
    largest = std::max(largest, bytes);
    held += bytes;
    if (held <= params_.budget || kept.empty()) kept.push_back(std::move(next));
  }
  const std::size_t slots = slotsFor(largest, frames_.size(), params_.budget, name);
  shared_ = std::make_unique<Shared>(frames_.size(), slots);
  loader_ = std::make_unique<Loader>(*this, placement, sampling);
  kept.resize(std::min(kept.size(), slots));
  for (std::size_t i = 0; i < kept.size(); ++i) {
    loader_->publish(static_cast<int>(i), i, std::move(kept[i]));
  }
  loader_->fetched = frames_.size();
  loader_->begin();
}

FrameSequence::~FrameSequence() = default;

int FrameSequence::count() const noexcept {
  return static_cast<int>(frames_.size());
}

int FrameSequence::within(int frame) const noexcept {
  return ((frame % count()) + count()) % count();
}

int FrameSequence::good(int frame, int way) const noexcept {
  for (int i = 0; i < count(); ++i, frame += way) {
    int at = frame;
    if (when_.repeat) {
      at = within(frame);
    } else if (frame < 0 || frame >= count()) {
      return -1;
    }
    if (!shared_->missing[static_cast<std::size_t>(at)].load(std::memory_order_acquire)) {
      return frame;
    }
  }
  return -1;
}

PlayMoment FrameSequence::at(double play) const noexcept {
  const std::vector<double>& times = when_.times;
  PlayMoment out;
  if (times.size() < 2 || !std::isfinite(play)) return out;
  const double from = times.front();
  const double length = times.back() - from;
  if (when_.repeat) {
    play = from + std::fmod(play - from, length);
    if (play < from) play += length;
  }
  play = std::clamp(play, from, times.back());
  const auto after = std::upper_bound(times.begin() + 1, times.end() - 1, play);
  const int i = static_cast<int>(after - times.begin()) - 1;
  const auto time_of = [&](int frame) {
    const double rounds = frame < 0 ? -1.0 : frame >= count() ? 1.0 : 0.0;
    if (!when_.repeat) return times[static_cast<std::size_t>(frame)];
    return times[static_cast<std::size_t>(within(frame))] + rounds * length;
  };
  out.position = i + (play - time_of(i)) / (time_of(i + 1) - time_of(i));
  // The first frame is always available, so frame i or an earlier frame is.
  const int low = good(i, -1);
  int high = good(i + 1, 1);
  if (high < 0) high = low;
  out.share = high == low
                  ? 0.0
                  : std::clamp((play - time_of(low)) / (time_of(high) - time_of(low)), 0.0, 1.0);
  out.low = within(low);
  out.high = within(high);
  return out;
}

double FrameSequence::way(const PlayMoment& a, const PlayMoment& b) const noexcept {
  const double way = b.position - a.position;
  return when_.repeat ? way - count() * std::round(way / count()) : way;
}

FrameSequence::Hold FrameSequence::hold(int frame) const noexcept {
  const int place =
      shared_->places[static_cast<std::size_t>(frame)].load(std::memory_order_acquire);
  if (place < 0) return {};
  Slot& slot = shared_->slots[static_cast<std::size_t>(place)];
  const std::uint32_t before = slot.users.fetch_add(1, std::memory_order_acq_rel);
  Hold held(&slot);
  const bool there = (before & kClosed) == 0 && slot.frame.load(std::memory_order_relaxed) == frame;
  if (!there) return {};
  return held;
}

FrameSequence::Hold::~Hold() {
  if (slot_ == nullptr) return;
  slot_->held.store(nowNs(), std::memory_order_relaxed);
  slot_->users.fetch_sub(1, std::memory_order_release);
}

const FieldPtr& FrameSequence::Hold::field() const noexcept {
  return slot_->loaded.field;
}

std::uint64_t FrameSequence::Hold::stay() const noexcept {
  return slot_->stay.load(std::memory_order_relaxed);
}

void FrameSequence::tell(const PlayMoment& at, double rate) const noexcept {
  shared_->low.store(at.low, std::memory_order_relaxed);
  shared_->high.store(at.high, std::memory_order_relaxed);
  if (rate != 0.0) shared_->way.store(rate > 0.0 ? 1 : -1, std::memory_order_relaxed);
}

std::unique_lock<std::mutex> FrameSequence::waitAlone() const {
  return std::unique_lock(loader_->alone);
}

bool FrameSequence::wait(std::span<const PlayMoment> moments, double seconds) const {
  const auto until = Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                        std::chrono::duration<double>(seconds));
  std::vector<int> needed;
  for (const PlayMoment& at : moments) {
    if (at.share < 1.0) needed.push_back(at.low);
    if (at.share > 0.0) needed.push_back(at.high);
  }
  const auto known = [&] {
    return std::all_of(needed.begin(), needed.end(), [&](int frame) {
      return shared_->resident(frame) ||
             shared_->missing[static_cast<std::size_t>(frame)].load(std::memory_order_acquire);
    });
  };
  if (known()) return true;
  std::unique_lock lock(loader_->mutex);
  for (const int frame : needed) ++loader_->asked[frame];
  loader_->changed.notify_all();
  const bool done =
      loader_->changed.wait_until(lock, until, [&] { return loader_->stop || known(); });
  for (const int frame : needed) {
    if (--loader_->asked[frame] == 0) loader_->asked.erase(frame);
  }
  return done;
}

std::uint64_t FrameSequence::neededFor(double speed) const noexcept {
  // Also counts the frames that readers held within the last kKept, and one frame that is being
  // loaded.
  double shortest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 1; i < when_.times.size(); ++i) {
    shortest = std::min(shortest, when_.times[i] - when_.times[i - 1]);
  }
  const double lately = std::chrono::duration<double>(kKept).count() * speed / shortest;
  return kLeastFrames + 1 + static_cast<std::uint64_t>(std::min(std::ceil(lately - 1e-6), 1e9));
}

SequenceState FrameSequence::state() const {
  SequenceState out;
  out.frames = frames_.size();
  out.empty = empty_;
  out.slots = shared_->slots.size();
  for (const Slot& slot : shared_->slots) {
    if (slot.frame.load(std::memory_order_relaxed) < 0) continue;
    ++out.resident;
    out.bytes += slot.bytes.load(std::memory_order_relaxed);
  }
  const std::lock_guard lock(loader_->mutex);
  out.fetched = loader_->fetched;
  out.failed = loader_->failing.size();
  return out;
}

std::vector<std::string> FrameSequence::takeTroubles() const {
  const std::lock_guard lock(loader_->mutex);
  return std::exchange(loader_->troubles, {});
}

}  // namespace palpate
