/// Measures the delay of ticks, and the part of this delay that the machine causes. Runs the haptic
/// thread, which may wake early (LoopParams::early), in turns with a bare loop of the same
/// priority. The delay of the bare loop is the machine's.
///
///     palpate_bench_clock [--rate HZ] [--seconds S] [--turns N] [--load THREADS]
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <CLI/CLI.hpp>

#include "bench/cold.h"
#include "bench/machine.h"
#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/samplers/grid/analytic_field.h"
#include "tests/support/percentiles.h"

namespace {

using namespace palpate;
using bench::LoopTimes;

struct Options {
  double rate = 1000.0;
  double seconds = 20.0;
  int turns = 3;
  int load = 0;
};

LoopTimes runBall(const Options& options, std::optional<double> early) {
  constexpr double kRadius = 0.04;
  GraphSpec spec;
  spec.modes.resize(1);
  spec.modes[0].kind = ModeKind::kIsosurface;
  spec.modes[0].of = "ball";
  spec.modes[0].solid = Solid::kBelow;
  spec.modes[0].strength = 3.0;
  const Box bounds{Vec3::Constant(-kRadius), Vec3::Constant(kRadius)};
  SimulatedDevice device(ArmParams{}, GripParams{}, explore(bounds, options.seconds), options.rate);
  LoopParams params;
  params.rate = options.rate;
  params.early = early;
  return bench::runHaptic(device, makeScene(spec, {{"ball", makeSphere(Vec3::Zero(), kRadius)}}),
                          params, options.seconds);
}

void tell(const char* name, const LoopTimes& times) {
  const auto row = [](const std::vector<double>& us) {
    std::printf(" %9.2f %9.2f %9.2f %9.1f", bench::percentile(us, 0.5), bench::percentile(us, 0.99),
                bench::percentile(us, 0.999), bench::percentile(us, 1.0));
  };
  std::printf("%-12s %8zu %6ld %8.1e %7lld", name, times.wake.size(), times.late,
              static_cast<double>(times.late) / static_cast<double>(times.wake.size()),
              static_cast<long long>(times.faults));
  row(times.wake);
  row(times.tick);
  std::printf("\n");
}

int measure(const Options& options) {
  std::printf("%s\n", bench::describe(bench::takeMachine(false)).c_str());
  std::printf("%g Hz, %d runs of %g s each, %d threads of other work\n", options.rate,
              options.turns, options.seconds, options.load);
  std::atomic<bool> done{false};
  std::vector<std::thread> others;
  others.reserve(static_cast<std::size_t>(options.load));
  for (int i = 0; i < options.load; ++i) {
    others.emplace_back([&] {
      // The load also reads and writes memory.
      std::vector<double> memory(1 << 20, 1.0);
      for (std::size_t n = 0; !done; n = (n + 4099) % memory.size())
        memory[n] = std::sqrt(memory[n] + 1.0);
    });
  }
  LoopTimes bare;
  LoopTimes asleep;
  LoopTimes early;
  for (int turn = 0; turn < options.turns; ++turn) {
    for (int i = 0; i < 3; ++i) {
      switch ((turn + i) % 3) {
        case 0:
          bare.add(bench::runBare(options.rate, options.seconds, {}));
          break;
        case 1:
          asleep.add(runBall(options, 0.0));
          break;
        default:
          early.add(runBall(options, std::nullopt));
          break;
      }
    }
  }
  done = true;
  for (std::thread& other : others) other.join();
  std::printf("%-12s %8s %6s %8s %7s %s %s\n", "loop", "ticks", "late", "share", "faults",
              " wake p50       p99     p99.9       max",
              "  tick p50       p99     p99.9       max  [us]");
  tell("bare", bare);
  tell("asleep", asleep);
  tell("early", early);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    Options options;
    CLI::App app{"Wake-up and tick times of the haptic thread and of a bare loop."};
    app.add_option("--rate", options.rate, "[Hz], default 1000");
    app.add_option("--seconds", options.seconds, "of a run, default 20");
    app.add_option("--turns", options.turns, "of each kind of run, default 3");
    app.add_option("--load", options.load, "threads of other work, default 0");
    CLI11_PARSE(app, argc, argv);
    return measure(options);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_clock: %s\n", e.what());
    return 2;
  }
}
