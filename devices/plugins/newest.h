/// What passes between an SDK's thread and palpate's, without a lock: the newest reading one way,
/// the force the other. For plug-ins in C++; needs nothing but the standard library.
#pragma once

#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <ctime>
#include <type_traits>

#include "palpate/devices/plugin.h"

namespace palpate_plugins {

/// The newest value of one writer's for one reader; neither ever waits. (Tests have an `Atomic`
/// that lets one in between two steps of the other.)
template <class T, template <class> class Atomic = std::atomic>
class Newest {
  static_assert(std::is_trivially_copyable_v<T>);

 public:
  void put(const T& value) noexcept {
    std::uint64_t words[kWords] = {};
    std::memcpy(words, &value, sizeof value);
    const std::uint64_t turn = turn_.load(std::memory_order_relaxed);
    turn_.store(turn + 1, std::memory_order_relaxed);  // odd: being written
    for (int i = 0; i < kWords; ++i) words_[i].store(words[i], std::memory_order_release);
    turn_.store(turn + 2, std::memory_order_release);
  }

  /// False: none since the last one taken (or it is being written just now), `value` is as it was.
  [[nodiscard]] bool take(T& value) noexcept {
    std::uint64_t words[kWords];
    for (int tries = 0; tries < 1000; ++tries) {
      const std::uint64_t turn = turn_.load(std::memory_order_acquire);
      if (turn == taken_) return false;
      if (turn % 2 == 1) continue;
      // Who reads a word of a later turn sees that turn's number below.
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
  std::uint64_t taken_ = 0;  // the reader's
};

/// What the motors are to give.
struct Order {
  double force[3] = {};      ///< In W [N].
  double share = 0.0;        ///< Of the arm's weight, that they carry besides.
  std::int64_t written = 0;  ///< [ns]
  std::uint32_t stops = 0;   ///< That had come before it.
};

/// palpate's forces on their way to an SDK's thread.
class Orders {
 public:
  /// A thread that goes on sending keeps the arm's own watchdog from ever seeing that palpate
  /// hangs: no force is sent on for longer than this [ns].
  static constexpr std::int64_t kHolds = 50'000'000;

  /// On the haptic thread; what `write` of a device returns.
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
    // After the zero, so that whoever finds the latch open finds no older force.
    if (zero) stopped_.store(false, std::memory_order_release);
    return PALPATE_PLUGIN_OK;
  }

  /// On any thread, and in a signal's handler. Returns when a zero has been sent, as the process
  /// may end next; where the SDK's thread does not come to it, after some 10 ms.
  void stop(int tries = 100) noexcept {
    stopped_.store(true, std::memory_order_release);
    const std::uint32_t stops = stops_.fetch_add(1, std::memory_order_acq_rel) + 1;
    const timespec pause = {0, 100'000};
    for (int i = 0; i < tries && served_.load(std::memory_order_acquire); ++i) {
      if (static_cast<std::int32_t>(zeros_.load(std::memory_order_acquire) - stops) >= 0) return;
      nanosleep(&pause, nullptr);
    }
  }

  /// Whether an SDK's thread sends what now() returns.
  void serve(bool served) noexcept { served_.store(served, std::memory_order_release); }

  /// On the SDK's thread: the arm has been given this.
  void sent(const Order& order) noexcept {
    if (order.force[0] != 0.0 || order.force[1] != 0.0 || order.force[2] != 0.0) return;
    zeros_.store(order.stops, std::memory_order_release);
  }

  /// What is to be sent now, on the SDK's thread: zeros once stopped, and where none has come for
  /// long.
  [[nodiscard]] Order now(std::int64_t now) noexcept {
    const std::uint32_t stops = stops_.load(std::memory_order_acquire);
    // Before the force: whoever finds that a zero has ended the stop finds that zero, or what came
    // after it.
    const bool stopped = stopped_.load(std::memory_order_acquire);
    (void)newest_.take(last_);
    Order order = stopped || now - last_.written > kHolds ? Order{} : last_;
    order.stops = stops;
    return order;
  }

 private:
  Newest<Order> newest_;
  Order last_;  // the SDK's thread's
  std::atomic<bool> stopped_{false};
  std::atomic<bool> served_{false};
  std::atomic<std::uint32_t> stops_{0};
  std::atomic<std::uint32_t> zeros_{0};  // stops before the last zero that was sent
};

}  // namespace palpate_plugins
