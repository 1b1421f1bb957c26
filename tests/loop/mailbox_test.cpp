/// Tests the mailbox between two threads. Spin checks a model of the mailbox's protocol
/// (mailbox.pml). These tests check the real mailbox, also under ThreadSanitizer.
#include "palpate/engine/loop/mailbox.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <memory>
#include <pthread.h>
#include <thread>

#include <catch2/catch.hpp>

#include "tests/support/counters.h"
#include "tests/support/random.h"

namespace palpate::mailbox_test {

namespace {

/// A value of 40 equal words. A copy with unequal words is torn.
struct Words {
  std::array<std::uint64_t, 40> words{};
  void fill(std::uint64_t n) { words.fill(n); }
  [[nodiscard]] bool whole() const {
    return std::all_of(words.begin(), words.end(), [&](std::uint64_t w) { return w == words[0]; });
  }
};

}  // namespace

TEST_CASE("refreshing a mailbox gives the newest value once and skips older values", "[mailbox]") {
  Mailbox<int> box;
  CHECK_FALSE(box.refresh());
  CHECK(box.current() == 0);
  box.draft() = 1;
  CHECK_FALSE(box.refresh());
  box.publish();
  CHECK(box.current() == 0);
  CHECK(box.refresh());
  CHECK(box.current() == 1);
  CHECK_FALSE(box.refresh());
  for (int i = 2; i <= 9; ++i) {
    box.draft() = i;
    box.publish();
  }
  CHECK(box.current() == 1);
  CHECK(box.refresh());
  CHECK(box.current() == 9);
  CHECK_FALSE(box.refresh());
  CHECK(box.current() == 9);
}

TEST_CASE("a mailbox with random writes and reads always gives the last published value",
          "[mailbox]") {
  test::Random random(3);
  Mailbox<long> box;
  long published = 0;
  long seen = 0;
  for (long i = 0; i < test::cases(300000); ++i) {
    if (random.integer(2) == 0) {
      box.draft() = ++published;
      box.publish();
    } else {
      CHECK(box.refresh() == (seen != published));
      seen = published;
      REQUIRE(box.current() == seen);
    }
  }
}

TEST_CASE("the values of a mailbox are freed by the writer's thread and at most three exist",
          "[mailbox][host]") {
  struct Owned {
    std::atomic<int>* alive;
    std::thread::id maker = std::this_thread::get_id();
    explicit Owned(std::atomic<int>* a) : alive(a) { ++*alive; }
    ~Owned() {
      --*alive;
      if (std::this_thread::get_id() != maker) std::abort();
    }
  };
  std::atomic<int> alive{0};
  {
    Mailbox<std::unique_ptr<Owned>> box;
    std::atomic<bool> done{false};
    std::thread reader([&] {
      while (!done.load()) {
        box.refresh();
        if (box.current() && box.current()->alive != &alive) std::abort();
      }
    });
    int most = 0;
    for (int i = 0; i < 50000; ++i) {
      box.draft() = std::make_unique<Owned>(&alive);
      box.publish();
      most = std::max(most, alive.load());
    }
    done = true;
    reader.join();
    CHECK(most <= 3);
  }
  CHECK(alive == 0);
}

TEST_CASE(
    "a mailbox between two threads gives whole values in rising order and finally the last one",
    "[mailbox][host]") {
  const long count = test::cases(2000000);
  Mailbox<Words> box;
  std::atomic<long> bad{0};
  std::uint64_t last = 0;
  std::thread reader([&] {
    while (last < static_cast<std::uint64_t>(count)) {
      if (!box.refresh()) continue;
      const Words& now = box.current();
      if (!now.whole() || now.words[0] <= last) ++bad;
      last = now.words[0];
    }
  });
  for (long n = 1; n <= count; ++n) {
    box.draft().fill(static_cast<std::uint64_t>(n));
    box.publish();
  }
  reader.join();  // the reader ends only after it has read the last value
  CHECK(bad == 0);
  CHECK(last == static_cast<std::uint64_t>(count));
}

namespace {

std::atomic<int> held{0};  // number of threads in the signal handler
std::atomic<bool> let_go{false};

extern "C" void hold(int /*signal*/) {
  held.fetch_add(1);
  while (!let_go.load()) {
  }
  held.fetch_sub(1);
}

}  // namespace

TEST_CASE("a thread that is stopped at a random point does not block the mailbox's other thread",
          "[mailbox][host]") {
  // A signal stops one thread at a random point, while the other continues.
  struct sigaction action {};
  action.sa_handler = hold;
  struct sigaction before {};
  REQUIRE(sigaction(SIGUSR1, &action, &before) == 0);
  test::Random random(5);
  // The number of rounds is small, because each round waits for the scheduler.
  const long count = test::share(300);
  for (const bool hold_writer : {true, false}) {
    Mailbox<Words> box;
    std::atomic<bool> done{false};
    std::atomic<std::uint64_t> next{1};
    std::uint64_t last = 0;
    bool whole = true;
    const auto write = [&] {
      box.draft().fill(next.fetch_add(1));
      box.publish();
    };
    const auto read = [&] {
      box.refresh();
      whole = whole && box.current().whole() && box.current().words[0] >= last;
      last = box.current().words[0];
    };
    std::thread other([&] {
      while (!done.load()) hold_writer ? write() : read();
    });
    for (long i = 0; i < count; ++i) {
      let_go = false;
      for (int k = random.integer(2000); k > 0; --k) hold_writer ? read() : write();
      pthread_kill(other.native_handle(), SIGUSR1);
      while (held.load() == 0) {
      }
      // The other thread completes 100 operations. If it waited for the stopped thread, the test
      // would hang.
      for (int k = 0; k < 100; ++k) hold_writer ? read() : write();
      let_go = true;
      while (held.load() != 0) {
      }
    }
    done = true;
    other.join();
    CHECK(whole);
    CHECK(next > static_cast<std::uint64_t>(count));
  }
  sigaction(SIGUSR1, &before, nullptr);
}

TEST_CASE("publishing to a mailbox and refreshing it neither allocate nor lock", "[mailbox]") {
  Mailbox<Words> box;
  const test::CountScope scope;
  for (int i = 0; i < 1000; ++i) {
    box.draft().fill(static_cast<std::uint64_t>(i));
    box.publish();
    box.refresh();
  }
  const test::Counts counts = test::CountScope::counts();
  CHECK(counts.allocations == 0);
  CHECK(counts.locks == 0);
}

}  // namespace palpate::mailbox_test
