/// Tests the loop with a real clock and threads. These tests have no limits for the times of ticks.
/// The hand's path counts ticks, so the tests also pass if a busy machine pauses a thread.
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <linux/capability.h>
#include <memory>
#include <sched.h>
#include <sys/syscall.h>
#include <thread>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "tests/support/random.h"
#include "tests/support/scenes.h"

namespace palpate::thread_test {
using palpate::test::ballField;
using palpate::test::ballScene;

namespace {

using namespace std::chrono_literals;

/// A device that two threads may read. Its limit for late ticks is high, because test machines are
/// sometimes late.
class SharedDevice final : public Device {
 public:
  SharedDevice() {
    about.name = "shared";
    about.watch.late = 1e3;
  }
  [[nodiscard]] const DeviceInfo& info() const noexcept override { return about; }
  [[nodiscard]] HandState read() noexcept override {
    HandState hand;
    hand.position = {0, 0, z.load()};
    return hand;
  }
  void write(const Vec3& force) noexcept override {
    sent.store(force.norm());
    ++writes;
  }
  [[nodiscard]] bool ended() const noexcept override { return over; }

  std::atomic<double> z{0.04};
  std::atomic<double> sent{0.0};
  std::atomic<long> writes{0};
  std::atomic<bool> over{false};

 private:
  DeviceInfo about;
};

LoopParams quiet() {
  LoopParams params;
  params.realtime = {0, -1, false, false};
  return params;
}

/// Waits until the condition holds. Fails after 600 s.
template <class What>
void await(What what) {
  const auto end = std::chrono::steady_clock::now() + 600s;
  while (!what()) {
    if (std::chrono::steady_clock::now() > end)
      FAIL("the condition did not become true within 600 s");
    std::this_thread::sleep_for(1ms);
  }
}

/// Waits for `count` more ticks.
void ticks(const SharedDevice& device, long count) {
  const long last = device.writes + count;
  await([&] { return device.writes >= last; });
}
constexpr long kEngagement = 1000;  ///< Ticks after which an engagement without force has ended.

/// Moves the hand to height `to` [m] in 60 steps. The ball's surface is at 0.03 m.
void move(SharedDevice& device, double to) {
  const double from = device.z;
  for (int i = 1; i <= 60; ++i) {
    device.z = from + (to - from) * i / 60.0;
    ticks(device, 2);
  }
}
constexpr double kIn = 0.027;
constexpr double kOut = 0.04;

}  // namespace

TEST_CASE("a haptic thread gives force from publish() to cut(), and ends with zero force",
          "[loop][host]") {
  SharedDevice device;
  {
    HapticThread hand(device, quiet());
    CHECK(hand.running());
    await([&] { return hand.latest().tick > 3; });
    CHECK(hand.latest().report.force == Vec3::Zero());
    hand.publish(ballScene(ballField()));
    await([&] { return hand.latest().scene != 0; });
    ticks(device, kEngagement);
    move(device, kIn);
    await([&] { return hand.latest().report.force.norm() > 1.0; });
    CHECK(device.sent > 0.0);
    hand.cut();
    await([&] { return hand.latest().fault == Fault::kStopped; });
    CHECK(device.sent == 0.0);
    hand.clear();
    await([&] { return hand.latest().fault == Fault::kNone; });
    move(device, kOut);
    ticks(device, kEngagement);
    move(device, kIn);
    await([&] { return hand.latest().report.force.norm() > 1.0; });
  }
  CHECK(device.sent == 0.0);
}

TEST_CASE("a haptic thread ends when its device ends", "[loop][host]") {
  SharedDevice device;
  HapticThread hand(device, quiet());
  hand.publish(ballScene(ballField()));
  await([&] { return hand.latest().tick > 3; });
  device.over = true;
  await([&] { return !hand.running(); });
  const long writes = device.writes;
  std::this_thread::sleep_for(5ms);
  CHECK(device.writes == writes);
  CHECK(device.sent == 0.0);
}

TEST_CASE("two hands act in one scene, each with its own proxy", "[loop][host]") {
  SharedDevice left;
  SharedDevice right;
  const auto scene = ballScene(ballField());
  HapticThread a(left, quiet());
  HapticThread b(right, quiet());
  a.publish(scene);
  b.publish(scene);
  await([&] { return a.latest().scene != 0 && b.latest().scene != 0; });
  ticks(left, kEngagement);
  ticks(right, kEngagement);
  move(left, kIn);
  await([&] { return a.latest().report.force.norm() > 1.0; });
  CHECK(b.latest().report.force == Vec3::Zero());
  move(right, kIn);
  await([&] { return b.latest().report.force.norm() > 1.0; });
  CHECK(a.latest().report.force.norm() > 1.0);
}

TEST_CASE("scenes that are replaced rapidly are freed on the thread that made them",
          "[loop][host]") {
  // ThreadSanitizer checks in this test that two threads do not access a scene, a tick or the
  // device at the same time.
  struct Watched final : public ScalarField {
    std::atomic<int>* alive;
    std::thread::id maker = std::this_thread::get_id();
    std::shared_ptr<const ScalarField> ball = std::get<0>(ballField());
    explicit Watched(std::atomic<int>* a)
        : ScalarField(std::get<0>(ballField())->frame()), alive(a) {
      ++*alive;
    }
    ~Watched() override {
      --*alive;
      if (std::this_thread::get_id() != maker) std::abort();
    }
    void reset(FieldCache& cache) const noexcept override { ball->reset(cache); }
    [[nodiscard]] ScalarSample sample(const Vec3& p, FieldCache& cache) const noexcept override {
      return ball->sample(p, cache);
    }
  };
  std::atomic<int> alive{0};
  {
    SharedDevice device;
    LoopParams params = quiet();
    params.rate = 5000.0;
    HapticThread hand(device, params);
    test::Random random(1);
    int most = 0;
    for (long i = 0; i < 300; ++i) {
      hand.publish(ballScene(FieldPtr(std::make_shared<const Watched>(&alive))));
      device.z = random.uniform(0.0299, 0.0301);
      most = std::max(most, alive.load());
      if (random.integer(3) == 0) std::this_thread::sleep_for(1ms);
    }
    await([&] { return hand.latest().tick > 100; });
    // The reader, the mailbox and the writer each own one scene.
    CHECK(most <= 3);
  }
  CHECK(alive == 0);
}

TEST_CASE("a heartbeat that stops is a fault if the loop has a limit for it", "[loop][host]") {
  SharedDevice device;
  LoopParams params = quiet();
  params.heartbeat = 0.3;
  HapticThread hand(device, params);
  hand.publish(ballScene(ballField()));
  for (int i = 0; i < 30; ++i) {
    hand.beat();
    std::this_thread::sleep_for(5ms);
  }
  await([&] { return hand.latest().fault == Fault::kHeartbeat; });
  CHECK(hand.latest().report.force == Vec3::Zero());
}

TEST_CASE("a loop refuses invalid rates and invalid lead times of its wake-up", "[loop]") {
  SharedDevice device;
  for (const double rate : {0.0, 499.0, 20001.0, -1.0, std::nan("")}) {
    LoopParams params = quiet();
    params.rate = rate;
    CHECK_THROWS_AS(HapticThread(device, params), DeviceError);
  }
  for (const double early : {-1e-6, 2.6e-4, std::nan("")}) {
    LoopParams params = quiet();
    params.early = early;
    CHECK_THROWS_AS(HapticThread(device, params), DeviceError);
  }
}

TEST_CASE("waking a haptic thread early does not make its ticks early", "[loop][host]") {
  struct Waits final : TickSink {
    void take(const Telemetry& tick, const ProxyState& /*state*/) noexcept override {
      early += tick.wake_ns < 0 ? 1 : 0;
      ++ticks;
    }
    std::atomic<int> early{0};
    std::atomic<int> ticks{0};
  } waits;
  SharedDevice device;
  LoopParams params = quiet();
  params.early = 2e-4;
  {
    HapticThread hand(device, params, &waits);
    CHECK(hand.early() == 2e-4);
    hand.publish(ballScene(ballField()));
    ticks(device, kEngagement);
    move(device, kIn);
    await([&] { return hand.latest().report.force.norm() > 1.0; });
  }
  CHECK(waits.ticks > kEngagement);
  CHECK(waits.early == 0);
  // Without real-time priority the thread does not spin, so that other threads can use its core.
  CHECK(HapticThread(device, quiet()).early() == 0.0);
  // With real-time priority, the thread spins at 1 kHz. At 10 kHz, the thread does not spin,
  // because spinning would take a large part of the period.
  for (const double rate : {1000.0, 10000.0}) {
    LoopParams usual;
    usual.rate = rate;
    const HapticThread hand(device, usual);
    CHECK(hand.early() == (hand.realtime().priority && rate < 2000.0 ? kEarly : 0.0));
  }
}

TEST_CASE("real-time settings that the system refuses are reported, and the loop still runs",
          "[loop][host]") {
  SharedDevice device;
  LoopParams params;
  params.realtime = {99, 4000, false, false};
  HapticThread hand(device, params);
  CHECK_FALSE(hand.realtime().core);
  const char* first = hand.realtime().priority ? "core 4000: " : "priority 90: ";
  CHECK(hand.realtime().refused.find(first) != std::string::npos);
  await([&] { return hand.latest().tick > 3; });
}

TEST_CASE("without real-time priority a haptic thread is not pinned to a core", "[loop][host]") {
  std::thread unprivileged([] {
    // Capabilities belong to a thread, resource limits to a process.
    __user_cap_header_struct head{_LINUX_CAPABILITY_VERSION_3, 0};
    std::array<__user_cap_data_struct, 2> may{};
    (void)syscall(SYS_capget, &head, may.data());
    may[0].effective &= ~(1U << CAP_SYS_NICE);
    (void)syscall(SYS_capset, &head, may.data());
    const auto cores = [] {
      cpu_set_t set;
      CHECK(sched_getaffinity(0, sizeof set, &set) == 0);
      return set;
    };
    const cpu_set_t before = cores();
    int first = 0;
    while (!CPU_ISSET(static_cast<std::size_t>(first), &before)) ++first;
    const RealtimeReport report = becomeRealtime({80, first, false, false}, StayAwake(false));
    CHECK(report.core == report.priority);
    const cpu_set_t after = cores();
    CHECK(CPU_COUNT(&after) == (report.priority ? 1 : CPU_COUNT(&before)));
  });
  unprivileged.join();
}

TEST_CASE("every tick of a loop reaches its sink in order", "[loop][host]") {
  struct Counts final : TickSink {
    std::int64_t last = 0;
    bool good = true;
    void take(const Telemetry& tick, const ProxyState& /*state*/) noexcept override {
      good = good && tick.tick == last + 1 && tick.wake_ns >= 0;
      last = tick.tick;
    }
  } counts;
  SharedDevice device;
  HapticThread hand(device, quiet(), &counts);
  hand.publish(ballScene(ballField()));
  await([&] { return hand.latest().tick > 50; });
  hand.stop();
  CHECK(counts.good);
  CHECK(counts.last == device.writes - 1);  // the last write is the zero force at the end
  CHECK_FALSE(hand.running());
}

}  // namespace palpate::thread_test
