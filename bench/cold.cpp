#include "bench/cold.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <sched.h>
#include <sys/resource.h>
#include <utility>

#include "tests/support/percentiles.h"

namespace palpate::bench {

namespace {

/// Returns the processor time of the calling thread [s].
double ownTime() noexcept {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

class Sink final : public TickSink {
 public:
  explicit Sink(std::size_t most) {
    times_.tick.reserve(most);
    times_.wake.reserve(most);
  }
  void take(const Telemetry& tick, const ProxyState& /*state*/) noexcept override {
    if (times_.tick.size() == times_.tick.capacity()) return;
    times_.tick.push_back(1e-3 * static_cast<double>(tick.tick_ns));
    times_.wake.push_back(1e-3 * static_cast<double>(tick.wake_ns));
    times_.late = static_cast<long>(tick.late_ticks);
    if (tick.tick == 1) {
      begin_ = tick.time;
      own_ = ownTime();
    } else if (tick.tick % 64 == 0) {  // not in every tick, because ownTime() is a system call
      times_.cpu = ownTime() - own_;
      times_.seconds = tick.time - begin_;
    }
  }
  [[nodiscard]] LoopTimes& times() { return times_; }

 private:
  LoopTimes times_;
  double begin_ = 0.0;
  double own_ = 0.0;
};

/// A piece of code with its own branches, different for each N.
template <std::size_t N>
[[gnu::noinline]] std::uint64_t piece(std::uint64_t x) {
  // Keeps the compiler from replacing the branches by conditional moves.
  const auto branch = [&](std::size_t bit, std::uint64_t y) {
    if ((x >> bit & 1) == 0) return;
    x ^= y;
    asm volatile("# a branch" : "+r"(x));
  };
  branch(N % 31, x * 6364136223846793005U + N);
  branch(20 + N % 23, x >> 29);
  branch(40 + N % 11, N * 12345);
  return x;
}

using Piece = std::uint64_t (*)(std::uint64_t);
constexpr std::size_t kPieces = 4096;

template <std::size_t... N>
constexpr std::array<Piece, sizeof...(N)> makePieces(std::index_sequence<N...> /*numbers*/) {
  return {piece<N>...};
}

void keepBusy(const std::atomic<bool>& done) {
  static constexpr auto kCode = makePieces(std::make_index_sequence<kPieces>{});
  std::vector<std::uint64_t> memory(1 << 20, 1);
  std::uint64_t x = 1;
  while (!done.load(std::memory_order_relaxed)) {
    x = x * 6364136223846793005U + 1442695040888963407U;
    x += kCode[(x >> 40) % kPieces](x);
    memory[(x >> 33) % memory.size()] += x;
  }
}

std::vector<int> cores() {
  std::vector<int> found;
  cpu_set_t allowed;
  CPU_ZERO(&allowed);
  (void)sched_getaffinity(0, sizeof allowed, &allowed);
  for (int core = 0; core < CPU_SETSIZE; ++core) {
    if (CPU_ISSET(static_cast<std::size_t>(core), &allowed)) found.push_back(core);
  }
  if (found.empty()) found.push_back(0);
  return found;
}

}  // namespace

void LoopTimes::add(const LoopTimes& other) {
  tick.insert(tick.end(), other.tick.begin(), other.tick.end());
  wake.insert(wake.end(), other.wake.begin(), other.wake.end());
  late += other.late;
  faults += other.faults;
  cpu += other.cpu;
  seconds += other.seconds;
  priority = priority && other.priority;
}

LoopTimes runBare(double rate, double seconds, const RealtimeRequest& request) {
  LoopTimes out;
  out.tick.reserve(static_cast<std::size_t>(seconds * rate) + 1);
  out.wake.reserve(static_cast<std::size_t>(seconds * rate) + 1);
  std::thread loop([&] {
    const StayAwake awake(request.awake);
    out.priority = becomeRealtime(request, awake).priority;
    const std::int64_t faults = pageFaults();
    const double own = ownTime();
    const double period = 1e9 / rate;
    const std::int64_t begin = nowNs();
    const auto count = static_cast<std::int64_t>(seconds * rate);
    for (std::int64_t i = 0; i < count; ++i) {
      const auto due =
          begin + static_cast<std::int64_t>(std::llround(static_cast<double>(i) * period));
      sleepUntil(due);
      const std::int64_t now = nowNs();
      out.tick.push_back(1e-3 * static_cast<double>(nowNs() - now));
      out.wake.push_back(1e-3 * static_cast<double>(now - due));
      if (static_cast<double>(now - due) > period) ++out.late;
      i = std::max(i, static_cast<std::int64_t>(static_cast<double>(now - begin) / period));
    }
    out.faults = pageFaults() - faults;
    out.cpu = ownTime() - own;
    out.seconds = 1e-9 * static_cast<double>(nowNs() - begin);
  });
  loop.join();
  return out;
}

LoopTimes runHaptic(Device& device, const std::shared_ptr<const Scene>& scene,
                    const LoopParams& params, double seconds) {
  Sink sink(static_cast<std::size_t>((seconds + 1.0) * params.rate));
  HapticThread hand(device, params, &sink);
  hand.publish(scene);
  const std::int64_t end = nowNs() + static_cast<std::int64_t>(1e9 * seconds);
  while (hand.running() && nowNs() < end) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  hand.stop();
  sink.times().faults = hand.pageFaultsSinceStart();
  sink.times().priority = hand.realtime().priority;
  return std::move(sink.times());
}

void printHead() {
  std::printf("%-22s %8s %8s %8s %8s %8s  %8s %8s %8s %6s %6s  [us]\n", "loop", "ticks", "tick p50",
              "p99", "p99.9", "max", "wake p50", "p99", "max", "late", "core");
}

void printRow(const std::string& loop, const LoopTimes& times) {
  std::printf("%-22s %8zu %8.2f %8.2f %8.2f %8.1f  %8.2f %8.2f %8.1f %6ld %5.1f%%%s\n",
              loop.c_str(), times.tick.size(), percentile(times.tick, 0.5),
              percentile(times.tick, 0.99), percentile(times.tick, 0.999),
              percentile(times.tick, 1.0), percentile(times.wake, 0.5),
              percentile(times.wake, 0.99), percentile(times.wake, 1.0), times.late,
              100.0 * times.cpu / std::max(1e-9, times.seconds),
              times.priority ? "" : "  without real-time priority");
}

int loopCore() {
  return cores().back();
}

Neighbour::Neighbour(const std::string& where) {
  if (where == "none") return;
  const int core = where == "own" ? loopCore() : cores().front();
  thread_ = std::thread([this, core] {
    cpu_set_t only;
    CPU_ZERO(&only);
    CPU_SET(static_cast<std::size_t>(core), &only);
    (void)sched_setaffinity(0, sizeof only, &only);
    // Raises this thread's priority above other work without real-time priority.
    (void)setpriority(PRIO_PROCESS, 0, -20);
    keepBusy(done_);
  });
}

Neighbour::~Neighbour() {
  done_ = true;
  if (thread_.joinable()) thread_.join();
}

}  // namespace palpate::bench
