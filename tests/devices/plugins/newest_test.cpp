/// Tests the exchange between an SDK's thread and palpate's haptic thread.
#include "devices/plugins/newest.h"

#include <atomic>
#include <functional>
#include <limits>
#include <thread>

#include <catch2/catch.hpp>

using namespace palpate_plugins;

namespace {

struct Large {
  std::uint64_t numbers[9];
  std::uint32_t last;
};

palpate_plugin_force forceOf(double x) {
  return {sizeof(palpate_plugin_force), 0, {x, 0.0, 0.0}, {}};
}

/// Function that runs once, before an atomic load or after an atomic store of put() or take().
std::function<void()> meanwhile;
int steps_until = 0;

template <class T>
struct Stepped : std::atomic<T> {
  using std::atomic<T>::atomic;
  static void step() {
    if (steps_until > 0 && --steps_until == 0) meanwhile();
  }
  T load(std::memory_order order) const {
    step();
    return std::atomic<T>::load(order);
  }
  void store(T value, std::memory_order order) {
    std::atomic<T>::store(value, order);
    step();
  }
};

Large large(std::uint64_t i) {
  Large value{};
  for (std::uint64_t& number : value.numbers) number = i;
  value.last = static_cast<std::uint32_t>(i);
  return value;
}

bool whole(const Large& value) {
  for (const std::uint64_t number : value.numbers) {
    if (number != value.last) return false;
  }
  return true;
}

}  // namespace

TEST_CASE(
    "a value that a plug-in shares is read whole if a write comes between two steps of the read",
    "[plugin]") {
  for (int step = 1; step <= 12; ++step) {
    CAPTURE(step);
    Newest<Large, Stepped> slot;
    slot.put(large(1));
    meanwhile = [&slot] { slot.put(large(2)); };
    steps_until = step;
    Large value{};
    REQUIRE(slot.take(value));
    CHECK(whole(value));
    if (value.last == 1) REQUIRE(slot.take(value));
    CHECK(whole(value));
    CHECK(value.last == 2U);
    CHECK_FALSE(slot.take(value));
  }
}

TEST_CASE(
    "a read of a plug-in's shared value between two steps of a write gets a whole value or none",
    "[plugin]") {
  // Step 1 comes before the first operation of put(), a load. Step 13 comes after its last store.
  for (int step = 1; step <= 13; ++step) {
    CAPTURE(step);
    Newest<Large, Stepped> slot;
    slot.put(large(1));
    Large value = large(7);
    bool taken = false;
    meanwhile = [&] { taken = slot.take(value); };
    steps_until = step;
    slot.put(large(2));
    CHECK(steps_until == 0);
    CHECK(whole(value));
    CHECK(value.last == (step == 1 ? 1U : step == 13 ? 2U : 7U));
    CHECK(taken == (step == 1 || step == 13));
    // A read that did not get the new value does not lose it.
    if (step != 13) CHECK(slot.take(value));
    CHECK(value.last == 2U);
  }
}

TEST_CASE("the reader of a plug-in's shared value gets each value whole and at most once",
          "[plugin]") {
  Newest<Large> slot;
  Large value{};
  CHECK_FALSE(slot.take(value));
  std::atomic<bool> ends{false};
  std::thread writer([&] {
    for (std::uint64_t i = 1; i <= 300000; ++i) {
      slot.put(large(i));
    }
    ends = true;
  });
  std::uint64_t before = 0;
  long torn = 0;
  long older = 0;
  for (bool last = false; !last;) {
    last = ends;
    while (slot.take(value)) {
      torn += whole(value) ? 0 : 1;
      older += value.numbers[0] <= before ? 1 : 0;
      before = value.numbers[0];
    }
  }
  writer.join();
  CHECK(torn == 0);
  CHECK(older == 0);
  CHECK(before == 300000U);
}

TEST_CASE("after a stop an SDK's thread gets no force until the host has written zero",
          "[plugin]") {
  Orders orders;
  std::atomic<int> turn{0};
  std::atomic<bool> stopped{false};
  long wrong = 0;
  // The SDK's thread must get zeros from the return of stop() until the next turn.
  std::thread sdk([&] {
    for (int n = turn; n < 2000; n = turn) {
      const bool was_stopped = stopped;
      const Order order = orders.now(0);
      if (was_stopped && turn == n && order.force[0] != 0.0) ++wrong;
      // After a written zero, an older force must not appear.
      if (order.force[0] != 0.0 && order.force[0] < n) ++wrong;
    }
  });
  for (int n = 1; n <= 2000; ++n) {
    orders.write(forceOf(n), 0.0, 0);
    orders.stop();
    stopped = true;
    orders.write(forceOf(n), 0.0, 0);
    stopped = false;
    orders.write(forceOf(0.0), 0.0, 0);
    turn = n;
  }
  sdk.join();
  CHECK(wrong == 0);
}

TEST_CASE("stop() returns when zero has been sent or when no thread sends forces", "[plugin]") {
  Orders orders;
  orders.stop(1'000'000);  // no SDK thread sends
  CHECK(orders.write(forceOf(0.0), 0.0, 0) == PALPATE_PLUGIN_OK);
  orders.serve(true);
  std::atomic<bool> ends{false};
  std::atomic<double> motor{0.0};
  std::thread sdk([&] {
    while (!ends) {
      const Order order = orders.now(0);
      std::this_thread::yield();  // the SDK's thread is still sending the force
      motor = order.force[0];
      orders.sent(order);
    }
    orders.serve(false);
  });
  constexpr int kForEver = 1'000'000;
  int wrong = 0;
  for (int i = 0; i < 200; ++i) {
    orders.write(forceOf(1.0), 0.0, 0);
    while (motor == 0.0) std::this_thread::yield();
    orders.stop(kForEver);
    wrong += motor == 0.0 ? 0 : 1;
    orders.write(forceOf(0.0), 0.0, 0);
  }
  ends = true;
  sdk.join();
  CHECK(wrong == 0);
  orders.stop(kForEver);
}

TEST_CASE("writing a non-finite force to a plug-in fails and sends zero", "[plugin]") {
  Orders orders;
  CHECK(orders.write(forceOf(1.0), 0.5, 7) == PALPATE_PLUGIN_OK);
  const Order order = orders.now(7);
  CHECK(order.force[0] == 1.0);
  CHECK(order.share == 0.5);
  CHECK(orders.write(forceOf(std::numeric_limits<double>::infinity()), 0.5, 8) ==
        PALPATE_PLUGIN_FAILED);
  CHECK(orders.now(8).force[0] == 0.0);
  CHECK(orders.now(8).share == 0.0);
}
