#include "palpate/samplers/bricks/brick_window.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <cstring>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <sys/mman.h>
#include <system_error>
#include <unistd.h>
#include <utility>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/half.h"
#include "palpate/samplers/retries.h"

namespace palpate {
namespace {

using Clock = std::chrono::steady_clock;
using Word = std::uint32_t;

/// Least number of slots beside the coarsest level; a hand's neighbourhood does not fit in fewer.
constexpr std::uint64_t kLeastSlots = 27;
/// Largest distance of requested bricks from a hand's present position [bricks of a level].
constexpr double kReachHere = 2.0;
/// Largest distance of requested bricks from a hand's future positions [bricks of a level].
constexpr double kReachAhead = 1.0;
/// Requests are chosen again if a hand has moved by this since the last choice [voxels].
constexpr double kMoved = 8.0;
/// Requests are chosen again if a hand's future position has moved by this [voxels].
constexpr double kTurned = kBrickSide / 2.0;
/// The path ahead is sampled once a brick, at most at this many places.
constexpr int kMostAhead = 8;
/// The look-ahead grows by this many times the delay of a brick.
constexpr double kDelays = 4.0;
/// A brick of path ahead counts as this distance from the path: the path is not straight.
constexpr double kAhead = 0.15;
/// A window needs memory for this many more bricks: the brick being read, packed and unpacked.
constexpr std::uint64_t kReading = 2;
/// Most messages of a kind, over the whole run.
constexpr int kMostTroubles = 8;
/// Interval of checks whether the volume exists; after two failures it is lost.
constexpr std::chrono::seconds kLook{1};
/// A hand that has not reported for this time is not followed any more.
constexpr std::chrono::seconds kSilent{1};
/// A proxy this near to a brick may read it before its next report [voxels of level 0].
constexpr double kFelt = 16.0;
/// Arrival time of bricks that were never awaited [ns].
constexpr std::int64_t kLongAgo = std::numeric_limits<std::int64_t>::min();
/// Largest part of the machine's memory for a window.
constexpr double kMostOfMemory = 0.75;

/// Returns the brick that a cell is read from, along an axis: its own. The cell before the first
/// brick is read from that brick, because the apron has its voxels.
int brickOf(int cell, int first) noexcept {
  constexpr int kShift = 6;
  static_assert(1 << kShift == kBrickSide);
  return ((cell == kBrickSide * first - 1 ? cell + 1 : cell) >> kShift) - first;  // rounds down
}

/// Converts a point in the index space of level 0 to that of another level.
Vec3 toLevel(const Vec3& p_0, std::int32_t level) noexcept {
  return (p_0 + Vec3::Constant(0.5)) * std::ldexp(1.0, -level) - Vec3::Constant(0.5);
}

}  // namespace

/// The last report of a hand: a seqlock, written by one thread and read by another.
struct BrickWindow::Told {
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
  struct Constant {
    std::array<float, 3> value{};
    bool active = false;
  };

  explicit Pool(const BrickManifest& manifest, const WindowParams& params);
  Pool(const Pool&) = delete;
  Pool& operator=(const Pool&) = delete;
  ~Pool() {
    if (memory != nullptr) munmap(memory, std::max<std::size_t>(slots, 1) * slot_bytes);
  }

  [[nodiscard]] std::byte* slotAt(std::size_t slot) const noexcept {
    return memory + slot * slot_bytes;
  }
  [[nodiscard]] std::optional<std::size_t> placeOf(std::int32_t level, int i, int j,
                                                   int k) const noexcept;
  /// Returns the state of a brick that is in the pyramid.
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

  /// Number of registered readers, by the side that they entered.
  struct alignas(64) Count {
    std::atomic<std::uint32_t> readers{0};
  };
  mutable std::array<Count, 2> in;
  std::atomic<std::uint64_t> changes{0};  ///< Changes of the tables.
  std::vector<BrickLevel> levels;
  BrickFormat format;
  std::vector<std::vector<std::atomic<std::uint64_t>>> tables;
  std::vector<Constant> constants;
  std::vector<std::atomic<std::int64_t>> arrivals;  ///< Per slot: time [ns of the steady clock].
  std::atomic<double> horizon;                      ///< Present look-ahead [s].
  std::atomic<std::uint32_t> side{0};               ///< The side that readers enter now.
  bool waits;
  std::array<Told, kMostHands> hands;
  std::atomic<std::size_t> numbered{0};
  std::atomic<std::uint64_t> aimed{0};  ///< Counts the changes that choose() has to follow.
  std::byte* memory = nullptr;
  std::size_t slots = 0;
  std::size_t slot_bytes = 0;
  bool locked = false;
};

BrickWindow::Pool::Pool(const BrickManifest& manifest, const WindowParams& params)
    : levels(manifest.levels()),
      format(manifest.format()),
      horizon(params.horizon),
      waits(params.waits) {
  slot_bytes = (format.bytes() + 63) / 64 * 64;
  const std::uint64_t brick = slot_bytes;
  std::uint64_t besides = kReading * brick;
  for (const BrickLevel& level : levels) besides += level.bricks() * sizeof(std::uint64_t);
  std::uint64_t stored = 0;
  for (std::int32_t l = 0; l < static_cast<std::int32_t>(levels.size()); ++l) {
    for (const BrickEntry& entry : manifest.entries(l)) {
      stored += entry.kind == BrickKind::kStored ? 1 : 0;
    }
  }
  slots = params.budget > besides ? (params.budget - besides) / brick : 0;
  slots = std::min<std::uint64_t>(slots, stored);
  const std::uint64_t least = std::min(stored, levels.back().bricks() + kLeastSlots);
  if (slots < least || params.budget < besides) {
    throw VolumeError(
        manifest.info().name,
        "a window of " + std::to_string(params.budget >> 20U) + " MB holds " +
            std::to_string(slots) + " of its bricks",
        "give it " + std::to_string(((least * brick + besides) >> 20U) + 1) + " MB or more");
  }
  const double machine =
      static_cast<double>(sysconf(_SC_PHYS_PAGES)) * static_cast<double>(sysconf(_SC_PAGESIZE));
  if (static_cast<double>(slots * brick) > kMostOfMemory * machine) {
    throw VolumeError(manifest.info().name,
                      "a window of " + std::to_string(slots * brick >> 20U) +
                          " MB is more than the machine's memory has room for",
                      "give it less");
  }
  constants.push_back({manifest.background(), false});
  for (const BrickLevel& level : levels) {
    tables.emplace_back(static_cast<std::size_t>(level.bricks()));
    const auto n = static_cast<std::int32_t>(tables.size() - 1);
    const Entry background(Entry::kConstant, 0, 0);
    for (auto& entry : tables.back()) entry.store(background.bits(), std::memory_order_relaxed);
    for (const BrickEntry& entry : manifest.entries(n)) {
      Entry at;
      if (entry.kind != BrickKind::kStored) {
        at = Entry(Entry::kConstant, static_cast<Word>(constants.size()), 0);
        constants.push_back({entry.value, entry.kind == BrickKind::kActive});
      }
      this->entry({n, entry.at}).store(at.bits(), std::memory_order_relaxed);
    }
  }
  arrivals = std::vector<std::atomic<std::int64_t>>(slots);
  const std::size_t bytes = std::max<std::size_t>(slots, 1) * slot_bytes;
  void* mapped = mmap(nullptr, bytes, PROT_READ | PROT_WRITE,
                      MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (mapped == MAP_FAILED) {
    throw VolumeError(manifest.info().name,
                      "there is no memory for a window of " + std::to_string(bytes >> 20U) + " MB",
                      "give it less");
  }
  memory = static_cast<std::byte*>(mapped);
  // With pages of the usual size a cell's rows lie on four or more.
  (void)madvise(mapped, bytes, MADV_HUGEPAGE);
  locked = params.lock && mlock(mapped, bytes) == 0;
}

std::optional<std::size_t> BrickWindow::Pool::placeOf(std::int32_t level, int i, int j,
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

/// Fetches requested bricks in a thread of its own.
struct BrickWindow::Loader {
  Loader(BrickSource& of, Pool& to);
  ~Loader() {
    stop = true;
    thread.join();
  }

  void run();
  [[nodiscard]] bool settle(Clock::time_point until);
  void choose();
  void take(const BrickArrival& arrival, std::unique_lock<std::mutex>& lock);
  void tell(const BrickArrival& of);
  void look(Clock::time_point now);
  void listen(Clock::time_point now);
  void publish(const BrickId& id, std::size_t slot);
  [[nodiscard]] bool isFelt(const BrickId& id) const noexcept;
  [[nodiscard]] std::size_t takeFree();
  [[nodiscard]] std::optional<std::size_t> evictFor(const BrickId& id);
  [[nodiscard]] bool leftByAll();
  [[nodiscard]] bool due(Clock::time_point now) const;

  BrickSource& source;
  Pool& pool;
  const double own_horizon;        ///< WindowParams::horizon.
  std::vector<std::byte> staging;  ///< Used by the thread only.

  mutable std::mutex mutex;  ///< Guards all down to the atomics; not held during fetches.
  std::condition_variable changed;
  std::vector<std::size_t> free;
  std::vector<std::optional<BrickId>> owners;
  std::vector<Word> generations;    ///< Per slot: number of bricks it has had.
  std::vector<std::uint64_t> used;  ///< Per slot: last choice that wanted its brick.
  std::uint64_t choices = 0;
  std::map<BrickId, double> wanted;  ///< With their distances.
  std::set<BrickId> awaited;
  detail::Retries<BrickId> failing;  ///< Bricks that cannot be fetched.
  bool doubt = false;                ///< The last check did not find the volume.
  Clock::time_point looked;
  std::set<std::pair<BrickId, BrickStatus>> told;
  std::map<BrickStatus, int> lines;  ///< Messages of a kind.
  struct Heard {
    std::uint32_t beats = 0;
    Clock::time_point at;
    bool alive = false;
  };
  std::array<Heard, kMostHands> heard;
  int settling = 0;  ///< Callers in settle(); while there is one, no hand counts as silent.
  std::size_t pinned = 0;
  std::vector<std::string> troubles;

  std::atomic<std::uint64_t> chosen{0};  ///< Pool::aimed at the last choice.
  std::atomic<std::size_t> pending{0};   ///< Size of `awaited`.
  std::atomic<std::uint64_t> resident{0};
  std::atomic<std::uint64_t> fetched{0};
  std::atomic<bool> gone{false};
  std::atomic<bool> stop{false};
  std::thread thread;
};

BrickWindow::Loader::Loader(BrickSource& of, Pool& to)
    : source(of), pool(to), own_horizon(to.horizon), staging(of.manifest().format().bytes()) {
  owners.resize(pool.slots);
  generations.resize(pool.slots);
  used.resize(pool.slots);
  free.reserve(pool.slots);
  for (std::size_t slot = pool.slots; slot-- > 0;) free.push_back(slot);
  const auto coarsest = static_cast<std::int32_t>(pool.levels.size() - 1);
  for (const BrickEntry& entry : source.manifest().entries(coarsest)) {
    if (entry.kind != BrickKind::kStored) continue;
    const BrickId id{coarsest, entry.at};
    const BrickArrival arrival = source.read(id, staging);
    if (arrival.status != BrickStatus::kArrived) {
      throw VolumeError(source.manifest().info().name, "its coarsest level is not whole",
                        arrival.why);
    }
    publish(id, takeFree());
    ++fetched;
    ++pinned;
  }
  looked = Clock::now();
  thread = std::thread([this] { run(); });
}

/// Returns true if a proxy is in a brick or beside it, where a new brick has to fade in.
bool BrickWindow::Loader::isFelt(const BrickId& id) const noexcept {
  const BrickLevel& level = pool.levels[static_cast<std::size_t>(id.level)];
  const double size = std::ldexp(1.0, id.level);
  for (std::size_t h = 0; h < kMostHands; ++h) {
    if (!heard[h].alive) continue;
    const auto aim = pool.hands[h].read();
    if (!aim) return true;  // being written now
    Vec3 off;
    const Vec3 at = toLevel(aim->proxy, id.level);
    for (std::size_t a = 0; a < 3; ++a) {
      const auto n = static_cast<Eigen::Index>(a);
      const double first = kBrickSide * (level.first[a] + id.at[a]);
      off[n] = at[n] - std::clamp(at[n], first, first + kBrickSide);
    }
    if (!(size * off.norm() > kFelt)) return true;
  }
  return false;
}

/// Waits until all readers that may have seen the tables' earlier state have left. Returns false if
/// the loader is to stop. Readers that enter from now on use the other side and see the present
/// state.
bool BrickWindow::Loader::leftByAll() {
  constexpr std::chrono::microseconds kLittle{20};
  const std::uint32_t side = pool.side.load();
  pool.side.store(1 - side);
  while (pool.in[side].readers.load() != 0) {
    if (stop) return false;
    std::this_thread::sleep_for(kLittle);
  }
  return true;
}

/// Copies the staged brick to a slot and enters it in the tables. No brick may be in the slot.
void BrickWindow::Loader::publish(const BrickId& id, std::size_t slot) {
  std::memcpy(pool.slotAt(slot), staging.data(), staging.size());
  owners[slot] = id;
  used[slot] = choices;
  // A brick that arrives away from all proxies does not fade in.
  pool.arrivals[slot].store(
      isFelt(id) ? Clock::now().time_since_epoch() / std::chrono::nanoseconds(1) : kLongAgo,
      std::memory_order_relaxed);
  const Entry entry(Entry::kSlot, static_cast<Word>(slot), ++generations[slot]);
  pool.entry(id).store(entry.bits(), std::memory_order_release);
  pool.changes.fetch_add(1, std::memory_order_release);
  ++resident;
}

std::size_t BrickWindow::Loader::takeFree() {
  const std::size_t slot = free.back();
  free.pop_back();
  return slot;
}

/// Frees the slot of the brick that is wanted least, if less than this one. Of unwanted bricks that
/// is the one unwanted for longest. The brick is then not in the tables, but readers may still be
/// in its slot.
std::optional<std::size_t> BrickWindow::Loader::evictFor(const BrickId& id) {
  const auto key = [&](const BrickId& of, std::uint64_t last) {
    const auto found = wanted.find(of);
    const bool is_wanted = found != wanted.end();
    const double far = is_wanted ? found->second : std::numeric_limits<double>::infinity();
    return std::pair(far, choices - last);
  };
  const auto coarsest = static_cast<std::int32_t>(pool.levels.size() - 1);
  std::optional<std::size_t> victim;
  auto least = key(id, choices);
  for (std::size_t slot = 0; slot < owners.size(); ++slot) {
    if (!owners[slot] || owners[slot]->level == coarsest) continue;
    const auto of = key(*owners[slot], used[slot]);
    if (of <= least) continue;
    least = of;
    victim = slot;
  }
  if (!victim) return std::nullopt;
  const BrickId old = *owners[*victim];
  pool.entry(old).store(Entry().bits(), std::memory_order_release);
  pool.changes.fetch_add(1, std::memory_order_release);
  owners[*victim].reset();
  --resident;
  return victim;
}

/// Requests the bricks nearest to hands now and in future, on all levels alike, by their own size.
void BrickWindow::Loader::choose() {
  struct Place {
    Vec3 p;
    double later;
    double reach;
  };
  std::vector<Place> places;
  const double horizon = own_horizon + kDelays * source.delay().count();
  pool.horizon.store(horizon, std::memory_order_relaxed);
  for (std::size_t h = 0; h < kMostHands; ++h) {
    if (!heard[h].alive) continue;
    const auto aim = pool.hands[h].read();
    if (!aim || !aim->probe.allFinite()) continue;
    if (aim->proxy.allFinite()) places.push_back({aim->proxy, 0.0, kReachHere});
    const Vec3& v = aim->velocity;
    const Vec3 way = v.allFinite() ? Vec3(horizon * v) : Vec3(Vec3::Zero());
    places.push_back({aim->probe, 0.0, kReachHere});
    const double length = way.norm() / kBrickSide;
    const int ahead = static_cast<int>(std::min<double>(kMostAhead, std::ceil(length)));
    for (int i = 1; i <= ahead; ++i) {
      const double went = std::min<double>(i, length);
      places.push_back({aim->probe + went / length * way, kAhead * went, kReachAhead});
    }
  }
  std::map<BrickId, double> all;
  for (std::size_t l = 0; l + 1 < pool.levels.size(); ++l) {
    const BrickLevel& level = pool.levels[l];
    for (const Place& place : places) {
      Vec3 b = toLevel(place.p, static_cast<std::int32_t>(l)) / kBrickSide;
      for (int a = 0; a < 3; ++a) b[a] -= level.first[static_cast<std::size_t>(a)];
      std::array<int, 3> low{};
      std::array<int, 3> high{};
      for (std::size_t a = 0; a < 3; ++a) {
        const double at = std::clamp(b[static_cast<Eigen::Index>(a)], -1e6, 1e6);
        low[a] = std::max(0, static_cast<int>(std::floor(at - place.reach)));
        high[a] = std::min(level.count[a] - 1, static_cast<int>(std::floor(at + place.reach)));
      }
      BrickId id{static_cast<std::int32_t>(l), {}};
      for (id.at[0] = low[0]; id.at[0] <= high[0]; ++id.at[0]) {
        for (id.at[1] = low[1]; id.at[1] <= high[1]; ++id.at[1]) {
          for (id.at[2] = low[2]; id.at[2] <= high[2]; ++id.at[2]) {
            const Vec3 corner(id.at[0], id.at[1], id.at[2]);
            const Vec3 off = (b - (b.cwiseMax(corner).cwiseMin(corner + Vec3::Ones())));
            // At equal distance a coarser brick comes first: it serves more.
            const double key = off.norm() + place.later - 1e-3 * static_cast<double>(l);
            const auto known = all.find(id);
            if (known != all.end() && known->second <= key) continue;
            if (pool.entryOf(id).kind() == Entry::kConstant) continue;
            all[id] = key;
          }
        }
      }
    }
  }
  std::vector<std::pair<double, BrickId>> order;
  order.reserve(all.size());
  for (const auto& [id, key] : all) order.emplace_back(key, id);
  std::sort(order.begin(), order.end());
  if (order.size() > pool.slots - pinned) order.resize(pool.slots - pinned);
  wanted.clear();
  awaited.clear();
  ++choices;
  std::vector<BrickWish> wishes;
  const Clock::time_point now = Clock::now();
  for (const auto& [key, id] : order) {
    wanted[id] = key;
    if (const Entry entry = pool.entryOf(id); entry.resident()) {
      used[entry.index()] = choices;
      continue;
    }
    if (!failing.may(id, now)) continue;
    awaited.insert(id);
    wishes.push_back({id, -key});
  }
  pending = awaited.size();
  source.want(std::move(wishes));
  changed.notify_all();
}

/// Reports each brick and kind of error once, and only a few of a kind.
void BrickWindow::Loader::tell(const BrickArrival& of) {
  const bool all = of.status == BrickStatus::kGone;
  if (!told.insert({all ? BrickId{} : of.id, of.status}).second) return;
  const int count = ++lines[of.status];
  if (count > kMostTroubles) return;
  std::string line = of.why;
  if (all) line += ": what is in memory is felt on";
  if (count == kMostTroubles) line += "; more like it are only counted";
  troubles.push_back(std::move(line));
}

void BrickWindow::Loader::take(const BrickArrival& arrival, std::unique_lock<std::mutex>& lock) {
  if (arrival.status == BrickStatus::kArrived) {
    ++fetched;
    failing.had(arrival.id);
    if (pool.entryOf(arrival.id).resident()) {
      // It was requested twice.
    } else if (!free.empty()) {
      publish(arrival.id, takeFree());
    } else if (const auto slot = evictFor(arrival.id)) {
      // A reader that does not leave for long stops the loader only.
      lock.unlock();
      const bool left = leftByAll();
      lock.lock();
      if (left) publish(arrival.id, *slot);
    }
  } else {
    (void)failing.failed(arrival.id, Clock::now());
    tell(arrival);
  }
  awaited.erase(arrival.id);
  pending = awaited.size();
  changed.notify_all();
}

/// Checks whether the volume exists.
void BrickWindow::Loader::look(Clock::time_point now) {
  if (now - looked < kLook) return;
  looked = now;
  const bool there = source.isThere();
  const std::lock_guard lock(mutex);
  const bool doubted = std::exchange(doubt, !there);
  if (!there && doubted && !gone) {
    gone = true;
    // Report it even if no fetch has failed.
    tell({{},
          BrickStatus::kGone,
          source.manifest().info().name + ": the volume is not there any more: bring it back"});
  }
  if (!there || !doubted) return;
  if (gone.exchange(false)) {
    troubles.push_back(source.manifest().info().name +
                       ": the volume is there again: switch the force on when the hand is ready");
  }
  std::erase_if(told, [](const auto& of) { return of.second == BrickStatus::kGone; });
  lines.erase(BrickStatus::kGone);
  // Fetches may have failed because the volume was about to go.
  failing.forget();
  choose();
}

/// Updates which hands report.
void BrickWindow::Loader::listen(Clock::time_point now) {
  for (std::size_t h = 0; h < kMostHands; ++h) {
    Heard& hand = heard[h];
    const std::uint32_t beats = pool.hands[h].beats.load(std::memory_order_acquire);
    const bool beat = beats != std::exchange(hand.beats, beats);
    if (beat || settling > 0) hand.at = now;
    if (beat == hand.alive) continue;
    // In virtual time the duration of a tick is not known.
    if (hand.alive && (pool.waits || now - hand.at < kSilent)) continue;
    hand.alive = beat;
    pool.aimed.fetch_add(1, std::memory_order_release);
  }
}

bool BrickWindow::Loader::due(Clock::time_point now) const {
  return failing.due(
      now, [&](const BrickId& id) { return wanted.contains(id) && !awaited.contains(id); });
}

void BrickWindow::Loader::run() {
  constexpr std::chrono::milliseconds kTurn{5};
  while (!stop) {
    const Clock::time_point begin = Clock::now();
    {
      const std::lock_guard lock(mutex);
      listen(begin);
      const std::uint64_t aimed = pool.aimed.load(std::memory_order_acquire);
      if (aimed != chosen || due(begin)) {
        choose();
        chosen = aimed;
      }
    }
    look(begin);
    do {
      const auto arrival = source.next(staging, kTurn);
      if (!arrival) break;
      std::unique_lock lock(mutex);
      take(*arrival, lock);
    } while (!stop && Clock::now() - begin < kTurn);
  }
}

bool BrickWindow::Loader::settle(Clock::time_point until) {
  if (chosen == pool.aimed.load(std::memory_order_acquire) && pending == 0) return true;
  std::unique_lock lock(mutex);
  listen(Clock::now());
  const std::uint64_t aimed = pool.aimed.load(std::memory_order_acquire);
  if (chosen != aimed) {
    choose();
    chosen = aimed;
  }
  ++settling;
  const bool settled = changed.wait_until(lock, until, [&] { return pending == 0; });
  --settling;
  return settled;
}

BrickWindow::BrickWindow(std::unique_ptr<BrickSource> source, const WindowParams& params)
    : source_(std::move(source)),
      params_(params),
      pool_(std::make_unique<Pool>(source_->manifest(), params)),
      loader_(std::make_unique<Loader>(*source_, *pool_)) {}

BrickWindow::~BrickWindow() = default;

std::size_t BrickWindow::newHand() const noexcept {
  return pool_->numbered.fetch_add(1, std::memory_order_relaxed) % kMostHands;
}

void BrickWindow::aim(std::size_t hand, const Aim& at) const noexcept {
  if (hand >= kMostHands) return;
  Told& told = pool_->hands[hand];
  const Aim last = told.last();
  const bool known = told.count.load(std::memory_order_relaxed) != 0;
  const double horizon = pool_->horizon.load(std::memory_order_relaxed);
  told.beats.fetch_add(1, std::memory_order_release);
  const auto near = [](const Vec3& a, const Vec3& b, double most) {
    return (a - b).squaredNorm() <= most * most;  // false for NaN
  };
  if (!known || !near(at.proxy, last.proxy, kMoved) || !near(at.probe, last.probe, kMoved) ||
      !near(horizon * at.velocity, horizon * last.velocity, kTurned)) {
    told.write(at);
    pool_->aimed.fetch_add(1, std::memory_order_release);
  }
}

BrickWindow::Entry BrickWindow::entryAt(std::int32_t level, int i, int j, int k) const noexcept {
  const auto place = pool_->placeOf(level, i, j, k);
  if (!place) return {Entry::kConstant, 0, 0};
  return Entry(
      pool_->tables[static_cast<std::size_t>(level)][*place].load(std::memory_order_acquire));
}

std::int64_t BrickWindow::arrival(const Entry& entry) const noexcept {
  return entry.kind() == Entry::kSlot
             ? pool_->arrivals[entry.index()].load(std::memory_order_relaxed)
             : kLongAgo;
}

std::uint32_t BrickWindow::enter() const noexcept {
  while (true) {
    const std::uint32_t side = pool_->side.load();
    pool_->in[side].readers.fetch_add(1);
    if (pool_->side.load() == side) return side;
    // The loader has changed sides and may have counted readers before: it does so once a brick.
    pool_->in[side].readers.fetch_sub(1);
  }
}

void BrickWindow::leave(std::uint32_t side) const noexcept {
  pool_->in[side].readers.fetch_sub(1);
}

std::uint64_t BrickWindow::changes() const noexcept {
  return pool_->changes.load(std::memory_order_acquire);
}

bool BrickWindow::cellAt(const Entry& entry, std::int32_t level, const std::array<int, 3>& cell,
                         Cell& out) const noexcept {
  const Pool& pool = *pool_;
  const std::size_t components = pool.format.components();
  out.active = 0;
  if (entry.kind() == Entry::kAbsent) return false;
  if (entry.kind() == Entry::kConstant) {
    const Pool::Constant& constant = pool.constants[entry.index()];
    for (std::size_t n = 0; n < 4 * components; ++n) out.room[n] = constant.value[n % components];
    out.rows.fill(out.room.data());
    out.active = constant.active ? ~std::uint64_t{0} : 0;
    return true;
  }
  const std::byte* const slot = pool.slotAt(entry.index());
  const BrickLevel& of = pool.levels[static_cast<std::size_t>(level)];
  std::array<int, 3> local{};
  for (std::size_t a = 0; a < 3; ++a) {
    const int at = brickOf(cell[a], of.first[a]);
    local[a] = cell[a] - kBrickSide * (at + of.first[a]);
  }
  const auto* const values = reinterpret_cast<const float*>(slot);
  const auto* const halves = reinterpret_cast<const std::uint16_t*>(slot);
  const auto* const bits = reinterpret_cast<const Word*>(slot + pool.format.activeBegin());
  const std::size_t corner = BrickView::numberOf(local[0] - 1, local[1] - 1, local[2] - 1);
  for (std::size_t row = 0; row < 16; ++row) {
    const std::size_t a = row / 4;
    const std::size_t b = row % 4;
    const std::size_t first = corner + (a * kBrickEdge + b) * kBrickEdge;
    if (pool.format.half) {
      float* const to = out.room.data() + row * 4 * components;
      for (std::size_t n = 0; n < 4 * components; ++n) {
        to[n] = floatOfHalf(halves[first * components + n]);
      }
      out.rows[row] = to;
    } else {
      out.rows[row] = values + first * components;
    }
    if (a % 3 == 0 || b % 3 == 0) continue;
    // Four bits, in one word or in two.
    const std::size_t shift = first % 32;
    Word four = bits[first / 32] >> shift;
    if (shift > 28) four |= bits[first / 32 + 1] << (32 - shift);
    out.active |= std::uint64_t{four & 15U} << (row * 4);
  }
  return true;
}

WindowState BrickWindow::state() const {
  WindowState out;
  out.slots = pool_->slots;
  out.resident = loader_->resident;
  out.bytes = (pool_->slots + kReading) * pool_->slot_bytes;
  for (const auto& table : pool_->tables) out.bytes += table.size() * sizeof(table[0]);
  out.fetched = loader_->fetched;
  out.locked = pool_->locked;
  out.gone = loader_->gone;
  const std::lock_guard lock(loader_->mutex);
  out.failed = loader_->failing.size();
  return out;
}

bool BrickWindow::lost() const noexcept {
  return loader_->gone.load(std::memory_order_relaxed);
}

std::shared_ptr<const Volume> BrickWindow::coarsest() const {
  return loadBricks(*source_, static_cast<std::int32_t>(pool_->levels.size() - 1),
                    manifest().info().name);
}

std::vector<std::string> BrickWindow::takeTroubles() const {
  const std::lock_guard lock(loader_->mutex);
  return std::exchange(loader_->troubles, {});
}

bool BrickWindow::settle(double seconds) const {
  return loader_->settle(Clock::now() + std::chrono::duration_cast<Clock::duration>(
                                            std::chrono::duration<double>(seconds)));
}

}  // namespace palpate
