/// Private to samplers: the thread that loads the bricks of a window. Include it in .cpp files
/// only.
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "palpate/samplers/bricks/brick_window.h"
#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/bricks/window_pool.h"
#include "palpate/samplers/retries.h"

namespace palpate {

/// Fetches requested bricks in a thread of its own.
struct BrickWindow::Loader {
  using Clock = std::chrono::steady_clock;

  /// Fetches the coarsest level and starts the thread. Throws VolumeError.
  Loader(BrickSource& of, Pool& to);
  ~Loader() {
    stop = true;
    thread.join();
  }

  void run();  ///< The thread's function.
  /// See BrickWindow::settle.
  [[nodiscard]] bool settle(Clock::time_point until);

  // The thread holds `mutex` during these calls, except during checkVolume() and leftByAll().
  void chooseRequests();
  void handleArrival(const BrickArrival& arrival, std::unique_lock<std::mutex>& lock);
  void reportOnce(const BrickArrival& of);
  void checkVolume(Clock::time_point now);
  void updateHands(Clock::time_point now);
  void publish(const BrickId& id, std::size_t slot);
  [[nodiscard]] bool isNearProxy(const BrickId& id) const noexcept;
  [[nodiscard]] std::size_t takeFree();
  [[nodiscard]] std::optional<std::size_t> evictFor(const BrickId& id);
  [[nodiscard]] bool leftByAll();
  [[nodiscard]] bool isRetryDue(Clock::time_point now) const;

  BrickSource& source;
  Pool& pool;
  const double own_horizon;        ///< WindowParams::horizon.
  std::vector<std::byte> staging;  ///< Used by the thread only.

  mutable std::mutex mutex;         ///< Guards all members down to `troubles`; free during fetches.
  std::condition_variable changed;  ///< Notified if `pending` may have changed.
  std::vector<std::size_t> free;    ///< Slots that never held a brick.
  std::vector<std::optional<BrickId>> owners;  ///< Per slot: its brick.
  std::vector<std::uint32_t> generations;      ///< Per slot: number of bricks it has had.
  std::vector<std::uint64_t> used;             ///< Per slot: last choice that wanted its brick.
  std::uint64_t choices = 0;                   ///< Number of calls of chooseRequests().
  std::map<BrickId, double> wanted;            ///< Bricks of the last choice, with their distances.
  std::set<BrickId> awaited;         ///< Requested bricks that have neither arrived nor failed.
  detail::Retries<BrickId> failing;  ///< Bricks that cannot be fetched.
  bool doubt = false;                ///< The last check did not find the volume.
  Clock::time_point checked_at;      ///< Time of the last checkVolume().
  std::set<std::pair<BrickId, BrickStatus>> reported;  ///< See reportOnce().
  std::map<BrickStatus, int> messages;                 ///< Number of messages, by kind of error.
  /// The reports of a hand.
  struct Following {
    std::uint32_t beats = 0;  ///< HandReport::beats when it was last looked up.
    Clock::time_point at;     ///< Time of the last report.
    bool alive = false;       ///< The window follows the hand.
  };
  std::array<Following, kMostHands> following;
  int settling = 0;        ///< Callers in settle(). During a call no hand counts as silent.
  std::size_t pinned = 0;  ///< Bricks of the coarsest level; never evicted.
  std::vector<std::string> troubles;  ///< See takeTroubles().

  std::atomic<std::uint64_t> chosen{0};  ///< Pool::aimed at the last choice.
  std::atomic<std::size_t> pending{0};   ///< Size of `awaited`.
  std::atomic<std::uint64_t> resident{0};
  std::atomic<std::uint64_t> fetched{0};
  std::atomic<bool> gone{false};
  std::atomic<bool> stop{false};
  std::thread thread;
};

}  // namespace palpate
