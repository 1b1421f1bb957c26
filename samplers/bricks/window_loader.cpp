#include "palpate/samplers/bricks/window_loader.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

/// Bricks within this distance of a hand's present position, along each axis, are requested [bricks
/// of the level].
constexpr double kReachHere = 2.0;
/// Bricks within this distance of a hand's predicted positions, along each axis, are requested
/// [bricks of the level].
constexpr double kReachAhead = 1.0;
/// Largest number of predicted positions of a hand. They are at most one brick of level 0 apart.
constexpr int kMostAhead = 8;
/// The look-ahead time grows by the delay of a brick times this number.
constexpr double kDelaysAhead = 4.0;
/// Distance added per brick of a predicted path, because the hand may leave the path [bricks].
constexpr double kDistancePerBrick = 0.15;
/// Largest number of messages about one kind of error.
constexpr int kMostMessages = 8;
/// Interval of checks for the volume, which counts as lost after two failed checks.
constexpr std::chrono::seconds kCheckInterval{1};
/// If a hand has not reported for this time, the loader stops following it.
constexpr std::chrono::seconds kSilent{1};
/// A proxy may read bricks within this distance before its next report [voxels of level 0].
constexpr double kNearProxy = 16.0;

Vec3 toLevel(const Vec3& p_0, std::int32_t level) noexcept {
  return (p_0 + Vec3::Constant(0.5)) * std::ldexp(1.0, -level) - Vec3::Constant(0.5);
}

}  // namespace

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
      throw VolumeError(source.manifest().info().name, "its coarsest level cannot be loaded",
                        arrival.why);
    }
    publish(id, takeFree());
    ++fetched;
    ++pinned;
  }
  checked_at = Clock::now();
  thread = std::thread([this] { run(); });
}

/// Returns true if a proxy is in a brick or near it: the brick must then fade in.
bool BrickWindow::Loader::isNearProxy(const BrickId& id) const noexcept {
  const BrickLevel& level = pool.levels[static_cast<std::size_t>(id.level)];
  const double size = std::ldexp(1.0, id.level);
  for (std::size_t h = 0; h < kMostHands; ++h) {
    if (!following[h].alive) continue;
    const auto aim = pool.hands[h].read();
    if (!aim) return true;  // the hand's report is being written now
    Vec3 off;
    const Vec3 at = toLevel(aim->proxy, id.level);
    for (std::size_t a = 0; a < 3; ++a) {
      const auto n = static_cast<Eigen::Index>(a);
      const double first = kBrickSide * (level.first[a] + id.at[a]);
      off[n] = at[n] - std::clamp(at[n], first, first + kBrickSide);
    }
    if (!(size * off.norm() > kNearProxy)) return true;
  }
  return false;
}

/// Waits until all readers of the old tables have left. Returns false if the loader must stop.
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

void BrickWindow::Loader::publish(const BrickId& id, std::size_t slot) {
  std::memcpy(pool.slotAt(slot), staging.data(), staging.size());
  owners[slot] = id;
  used[slot] = choices;
  // A brick that arrives far from all proxies counts as completely faded in.
  pool.arrivals[slot].store(isNearProxy(id)
                                ? Clock::now().time_since_epoch() / std::chrono::nanoseconds(1)
                                : Pool::kLongAgo,
                            std::memory_order_relaxed);
  const Entry entry(Entry::kSlot, static_cast<std::uint32_t>(slot), ++generations[slot]);
  pool.entry(id).store(entry.bits(), std::memory_order_release);
  pool.changes.fetch_add(1, std::memory_order_release);
  ++resident;
}

std::size_t BrickWindow::Loader::takeFree() {
  const std::size_t slot = free.back();
  free.pop_back();
  return slot;
}

/// Removes a brick from the tables: the one that has been unwanted for the longest time, else the
/// farthest wanted one if `id` is nearer. Returns its slot, which readers may still read;
/// std::nullopt if no brick can be removed.
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

/// Chooses the bricks nearest to the present and predicted positions of the hands, and requests
/// those that are not in memory.
void BrickWindow::Loader::chooseRequests() {
  struct Place {
    Vec3 p;
    double later;
    double reach;
  };
  std::vector<Place> places;
  const double horizon = own_horizon + kDelaysAhead * source.delay().count();
  pool.horizon.store(horizon, std::memory_order_relaxed);
  for (std::size_t h = 0; h < kMostHands; ++h) {
    if (!following[h].alive) continue;
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
      places.push_back({aim->probe + went / length * way, kDistancePerBrick * went, kReachAhead});
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
            // At equal distances, the coarser level comes first: its brick covers more space.
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

/// Reports each brick and kind of error once, and at most kMostMessages errors of a kind.
void BrickWindow::Loader::reportOnce(const BrickArrival& of) {
  const bool all = of.status == BrickStatus::kGone;
  if (!reported.insert({all ? BrickId{} : of.id, of.status}).second) return;
  const int count = ++messages[of.status];
  if (count > kMostMessages) return;
  std::string line = of.why;
  if (all) line += ": the bricks in memory remain in use";
  if (count == kMostMessages) line += "; further errors of this kind are only counted";
  troubles.push_back(std::move(line));
}

void BrickWindow::Loader::handleArrival(const BrickArrival& arrival,
                                        std::unique_lock<std::mutex>& lock) {
  if (arrival.status == BrickStatus::kArrived) {
    ++fetched;
    failing.had(arrival.id);
    if (pool.entryOf(arrival.id).resident()) {
      // The brick is already in the pool, because it was requested twice.
    } else if (!free.empty()) {
      publish(arrival.id, takeFree());
    } else if (const auto slot = evictFor(arrival.id)) {
      // Waits without the mutex, so that a reader that does not leave blocks only the loader.
      lock.unlock();
      const bool left = leftByAll();
      lock.lock();
      if (left) publish(arrival.id, *slot);
    }
  } else {
    (void)failing.failed(arrival.id, Clock::now());
    reportOnce(arrival);
  }
  awaited.erase(arrival.id);
  pending = awaited.size();
  changed.notify_all();
}

void BrickWindow::Loader::checkVolume(Clock::time_point now) {
  if (now - checked_at < kCheckInterval) return;
  checked_at = now;
  const bool there = source.isThere();
  const std::lock_guard lock(mutex);
  const bool doubted = std::exchange(doubt, !there);
  if (!there && doubted && !gone) {
    gone = true;
    // Reports the loss even if no fetch has failed yet.
    reportOnce({{},
                BrickStatus::kGone,
                source.manifest().info().name +
                    ": the volume does not exist any more, was replaced, or cannot be reached: "
                    "restore it, check the network, or start the program again to load its "
                    "replacement"});
  }
  if (!there || !doubted) return;
  if (gone.exchange(false)) {
    troubles.push_back(
        source.manifest().info().name +
        ": the volume is available again: switch the force on when the hand is ready");
  }
  std::erase_if(reported, [](const auto& of) { return of.second == BrickStatus::kGone; });
  messages.erase(BrickStatus::kGone);
  // Earlier fetches may have failed only because of the loss, so the loader retries them
  // immediately.
  failing.forget();
  chooseRequests();
}

void BrickWindow::Loader::updateHands(Clock::time_point now) {
  for (std::size_t h = 0; h < kMostHands; ++h) {
    Following& hand = following[h];
    const std::uint32_t beats = pool.hands[h].beats.load(std::memory_order_acquire);
    const bool beat = beats != std::exchange(hand.beats, beats);
    if (beat || settling > 0) hand.at = now;
    if (beat == hand.alive) continue;
    // In virtual time the real duration of a tick is unknown, so no hand counts as silent.
    if (hand.alive && (pool.waits || now - hand.at < kSilent)) continue;
    hand.alive = beat;
    pool.aimed.fetch_add(1, std::memory_order_release);
  }
}

bool BrickWindow::Loader::isRetryDue(Clock::time_point now) const {
  return failing.due(
      now, [&](const BrickId& id) { return wanted.contains(id) && !awaited.contains(id); });
}

void BrickWindow::Loader::run() {
  constexpr std::chrono::milliseconds kPeriod{5};
  while (!stop) {
    const Clock::time_point begin = Clock::now();
    {
      const std::lock_guard lock(mutex);
      updateHands(begin);
      const std::uint64_t aimed = pool.aimed.load(std::memory_order_acquire);
      if (aimed != chosen || isRetryDue(begin)) {
        chooseRequests();
        chosen = aimed;
      }
    }
    checkVolume(begin);
    do {
      const auto arrival = source.next(staging, kPeriod);
      if (!arrival) break;
      std::unique_lock lock(mutex);
      handleArrival(*arrival, lock);
    } while (!stop && Clock::now() - begin < kPeriod);
  }
}

bool BrickWindow::Loader::settle(Clock::time_point until) {
  if (chosen == pool.aimed.load(std::memory_order_acquire) && pending == 0) return true;
  std::unique_lock lock(mutex);
  updateHands(Clock::now());
  const std::uint64_t aimed = pool.aimed.load(std::memory_order_acquire);
  if (chosen != aimed) {
    chooseRequests();
    chosen = aimed;
  }
  ++settling;
  const bool settled = changed.wait_until(lock, until, [&] { return pending == 0; });
  --settling;
  return settled;
}

}  // namespace palpate
