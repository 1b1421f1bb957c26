/// Private to samplers, for .cpp files only: the thread that loads the bricks of a window.
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

struct BrickWindow::Loader {
  using Clock = std::chrono::steady_clock;

  /// Fetches the coarsest level and starts the thread. Throws VolumeError.
  Loader(BrickSource& of, Pool& to);
  ~Loader() {
    stop = true;
    thread.join();
  }

  void run();
  [[nodiscard]] bool settle(Clock::time_point until);

  // Callers hold `mutex`, except in the constructor, and for checkVolume() and leftByAll().
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
  const double own_horizon;        ///< Value of WindowParams::horizon.
  std::vector<std::byte> staging;  ///< Brick that arrived last; only the thread uses it.

  /// Guards the members from here down to `troubles`, except `checked_at`, which only the thread
  /// uses. The thread does not hold the mutex during a fetch.
  mutable std::mutex mutex;
  std::condition_variable changed;             ///< Notified when `pending` may have changed.
  std::vector<std::size_t> free;               ///< Slots that have never contained a brick.
  std::vector<std::optional<BrickId>> owners;  ///< For each slot, the brick that it contains.
  /// For each slot, the number of bricks that it has contained.
  std::vector<std::uint32_t> generations;
  /// For each slot, the number of the last choice that wanted its brick, or else of the last choice
  /// before the brick arrived.
  std::vector<std::uint64_t> used;
  std::uint64_t choices = 0;         ///< Number of calls of chooseRequests().
  std::map<BrickId, double> wanted;  ///< Bricks of the last choice, with their distances.
  std::set<BrickId> awaited;         ///< Requested bricks that have neither arrived nor failed.
  detail::Retries<BrickId> failing;  ///< Bricks whose last fetch failed.
  bool doubt = false;                ///< True if the last check did not find the volume.
  Clock::time_point checked_at;
  std::set<std::pair<BrickId, BrickStatus>> reported;  ///< Errors that reportOnce() has reported.
  std::map<BrickStatus, int> messages;                 ///< Number of errors of each kind.
  /// State of the reports of one hand.
  struct Following {
    std::uint32_t beats = 0;  ///< Value of HandReport::beats at the last check.
    Clock::time_point at;     ///< Time of the last check with a new report or a settle() call.
    bool alive = false;       ///< True if the loader follows the hand.
  };
  std::array<Following, kMostHands> following;
  /// Number of callers in settle(). While it is above 0, no hand counts as silent.
  int settling = 0;
  std::size_t pinned = 0;  ///< Number of bricks of the coarsest level, which are never removed.
  std::vector<std::string> troubles;  ///< Errors for takeTroubles().

  std::atomic<std::uint64_t> chosen{0};  ///< Value of Pool::aimed at the last choice.
  std::atomic<std::size_t> pending{0};   ///< Size of `awaited`.
  std::atomic<std::uint64_t> resident{0};
  std::atomic<std::uint64_t> fetched{0};
  std::atomic<bool> gone{false};
  std::atomic<bool> stop{false};
  std::thread thread;
};

}  // namespace palpate
