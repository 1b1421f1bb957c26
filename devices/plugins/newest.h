/// Private to devices: lock-free exchange between an SDK's thread and palpate's haptic thread, for
/// plug-ins in C++. Needs only the standard library.
#pragma once

#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <ctime>
#include <type_traits>

#include "plugin.h"

namespace palpate_plugins {

/// Passes the newest value from one writer to one reader; neither waits. Tests replace `Atomic`.
template <class T, template <class> class Atomic = std::atomic>
class Newest {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  void put(const T& value) noexcept {
    std::uint64_t words[kWords] = {};
    std::memcpy(words, &value, sizeof value);
    const std::uint64_t turn = turn_.load(std::memory_order_relaxed);
    turn_.store(turn + 1, std::memory_order_relaxed);  // odd while the value is being written
    for (int i = 0; i < kWords; ++i) words_[i].store(words[i], std::memory_order_release);
    turn_.store(turn + 2, std::memory_order_release);
  }

  /// Reads the newest value. Returns false, and leaves `value` unchanged, if no value has come
  /// since the last take(), or if writes disturb each of 1,000 attempts.
  [[nodiscard]] bool take(T& value) noexcept {
    std::uint64_t words[kWords];
    for (int tries = 0; tries < 1000; ++tries) {
      const std::uint64_t turn = turn_.load(std::memory_order_acquire);
      if (turn == taken_) return false;
      if (turn % 2 == 1) continue;
      // A reader that sees a word of a later turn also sees that turn's number in the check below.
      for (int i = 0; i < kWords; ++i) words[i] = words_[i].load(std::memory_order_acquire);
      if (turn_.load(std::memory_order_relaxed) != turn) continue;
      std::memcpy(&value, words, sizeof value);
      taken_ = turn;
      return true;
    }
    return false;
  }

 private:
  static constexpr int kWords = (sizeof(T) + 7) / 8;
  Atomic<std::uint64_t> turn_{0};
  Atomic<std::uint64_t> words_[kWords] = {};
  std::uint64_t taken_ = 0;  // owned by the reader
};

struct Order {
  double force[3] = {};      ///< In W [N].
  double share = 0.0;        ///< Share of the arm's weight that the motors also carry.
  std::int64_t written = 0;  ///< Time of the write [ns].
  std::uint32_t stops = 0;   ///< Number of stops when now() returned this order.
};

class Orders {
 public:
  /// Longest time for which one order is sent [ns]. Without this limit, an SDK's thread would feed
  /// the arm's own watchdog although palpate hangs.
  static constexpr std::int64_t kHolds = 50'000'000;

  /// Stores an order. Called on the haptic thread. Returns the result for
  /// palpate_plugin_device::write.
  int write(const palpate_plugin_force& force, double share, std::int64_t now) noexcept {
    Order order;
    bool zero = true;
    bool finite = true;
    for (int i = 0; i < 3; ++i) {
      order.force[i] = force.force[i];
      zero = zero && force.force[i] == 0.0;
      finite = finite && std::isfinite(force.force[i]);
    }
    if (!finite) {
      stop(0);
      return PALPATE_PLUGIN_FAILED;
    }
    order.share = share;
    order.written = now;
    newest_.put(order);
    // Ends the stop after the zero is stored, so that no older force follows.
    if (zero) stopped_.store(false, std::memory_order_release);
    return PALPATE_PLUGIN_OK;
  }

  /// Stops the force. If an SDK's thread serves, waits until a zero has been sent, because the
  /// process may end next, but at most `tries` times 0.1 ms. Callable from any thread and from
  /// signal handlers.
  void stop(int tries = 100) noexcept {
    stopped_.store(true, std::memory_order_release);
    const std::uint32_t stops = stops_.fetch_add(1, std::memory_order_acq_rel) + 1;
    const timespec pause = {0, 100'000};
    for (int i = 0; i < tries && served_.load(std::memory_order_acquire); ++i) {
      if (static_cast<std::int32_t>(zeros_.load(std::memory_order_acquire) - stops) >= 0) return;
      nanosleep(&pause, nullptr);
    }
  }

  /// Sets whether an SDK's thread sends the orders that now() returns.
  void serve(bool served) noexcept { served_.store(served, std::memory_order_release); }

  /// Records that the arm has received this order; called on the SDK's thread.
  void sent(const Order& order) noexcept {
    if (order.force[0] != 0.0 || order.force[1] != 0.0 || order.force[2] != 0.0) return;
    zeros_.store(order.stops, std::memory_order_release);
  }

  /// Returns the order to send now: zero after a stop, or if the last order is too old. Called on
  /// the SDK's thread.
  [[nodiscard]] Order now(std::int64_t now) noexcept {
    const std::uint32_t stops = stops_.load(std::memory_order_acquire);
    // Reads `stopped_` before the force: if a zero has ended a stop, no older order is taken.
    const bool stopped = stopped_.load(std::memory_order_acquire);
    (void)newest_.take(last_);
    Order order = stopped || now - last_.written > kHolds ? Order{} : last_;
    order.stops = stops;
    return order;
  }

 private:
  Newest<Order> newest_;
  Order last_;  // owned by the SDK's thread
  std::atomic<bool> stopped_{false};
  std::atomic<bool> served_{false};
  std::atomic<std::uint32_t> stops_{0};
  std::atomic<std::uint32_t> zeros_{0};  // value of `stops` in the last zero that was sent
};

}  // namespace palpate_plugins
