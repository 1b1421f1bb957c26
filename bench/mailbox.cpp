/// Measures the time of a write and of a read of the mailbox, alone and while the other end is
/// busy. Checks that no value arrives torn or after a newer one, and that the last value arrives.
///
///     palpate_bench_mailbox [EXCHANGES, default 100,000,000]
#include "palpate/engine/loop/mailbox.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <vector>

#include "bench/machine.h"
#include "palpate/engine/loop/telemetry.h"
#include "tests/support/percentiles.h"

namespace {

using namespace palpate;

// Calls that are timed together, because a single call is shorter than the clock's step.
constexpr int kBatch = 64;

/// Returns the time per call [ns], one value per batch, measured while `on` returns true.
template <class Call, class While>
std::vector<double> timed(const Call& call, const While& on) {
  std::vector<double> ns;
  ns.reserve(1 << 20);
  while (on() && ns.size() < ns.capacity()) {
    const auto start = bench::Clock::now();
    for (int i = 0; i < kBatch; ++i) call();
    ns.push_back(std::chrono::duration<double, std::nano>(bench::Clock::now() - start).count() /
                 kBatch);
  }
  return ns;
}

void tell(const char* what, const char* when, const std::vector<double>& ns) {
  std::printf("%-8s %-12s %10zu %8.1f %8.1f %8.1f\n", what, when, ns.size() * kBatch,
              bench::percentile(ns, 0.5), bench::percentile(ns, 0.99),
              bench::percentile(ns, 0.999));
}

void time() {
  std::printf("%-8s %-12s %10s %8s %8s %8s\n", "end", "other end", "calls", "p50 ns", "p99 ns",
              "p99.9 ns");
  constexpr std::chrono::milliseconds kLong(500);
  for (const bool busy : {false, true}) {
    for (const bool writer : {true, false}) {
      Mailbox<std::uint64_t> box;
      const auto publish = [&] {
        ++box.draft();
        box.publish();
      };
      const auto refresh = [&] { (void)box.refresh(); };
      std::atomic<bool> done{false};
      std::thread other([&] {
        while (busy && !done) writer ? refresh() : publish();
      });
      const auto end = bench::Clock::now() + kLong;
      const auto on = [&] { return bench::Clock::now() < end; };
      const auto ns = writer ? timed(publish, on) : timed(refresh, on);
      done = true;
      other.join();
      tell(writer ? "publish" : "refresh", busy ? "busy" : "still", ns);
    }
  }
}

struct Words {
  std::array<std::uint64_t, sizeof(Telemetry) / 8> words{};
};

bool exchange(std::uint64_t count) {
  Mailbox<Words> box;
  std::uint64_t torn = 0;
  std::uint64_t older = 0;
  std::uint64_t taken = 0;
  std::uint64_t last = 0;
  std::thread reader([&] {
    while (last < count) {
      if (!box.refresh()) continue;
      const auto& words = box.current().words;
      torn +=
          std::all_of(words.begin(), words.end(), [&](std::uint64_t w) { return w == words[0]; })
              ? 0
              : 1;
      older += words[0] > last ? 0 : 1;
      last = words[0];
      ++taken;
    }
  });
  const auto start = bench::Clock::now();
  for (std::uint64_t n = 1; n <= count; ++n) {
    box.draft().words.fill(n);
    box.publish();
  }
  reader.join();
  const double seconds = std::chrono::duration<double>(bench::Clock::now() - start).count();
  std::printf(
      "%llu values of %zu bytes in %.1f s, %llu of them taken: %llu torn, %llu older, last %s\n",
      static_cast<unsigned long long>(count), sizeof(Words), seconds,
      static_cast<unsigned long long>(taken), static_cast<unsigned long long>(torn),
      static_cast<unsigned long long>(older), last == count ? "there" : "lost");
  return torn == 0 && older == 0 && last == count;
}

}  // namespace

int main(int argc, char** argv) {
  const std::uint64_t count = argc > 1 ? std::strtoull(argv[1], nullptr, 10) : 100000000;
  std::printf("%s\n", bench::describe(bench::takeMachine(false)).c_str());
  time();
  return exchange(std::max<std::uint64_t>(count, 1)) ? 0 : 1;
}
