/// Measures the cost of one whole tick. Runs a scene with the simulated device without pauses.
/// Prints times and iterations by number of primitives, and the ticks that did not converge. Then
/// measures the same ticks as with a real hand (bench/cold.h): the haptic thread sleeps until each
/// tick's time, in turns with a bare loop, which shows the time of clock and wake-up.
///
///     palpate_bench_tick SCENE [SECONDS [REPEATS]] [--cold SECONDS] [--neighbour own|other|none]
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <exception>
#include <map>
#include <numeric>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "bench/cold.h"
#include "bench/machine.h"
#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/tick/step.h"
#include "palpate/scenes/library/scene_file.h"
#include "tests/support/percentiles.h"

namespace {

using namespace palpate;
using bench::Clock;

struct Times {
  std::vector<double> ns;
  std::vector<double> iterations;
};

void print(const std::string& what, Times& times) {
  std::sort(times.ns.begin(), times.ns.end());
  std::sort(times.iterations.begin(), times.iterations.end());
  const auto count = static_cast<double>(times.ns.size());
  const double sum = std::accumulate(times.iterations.begin(), times.iterations.end(), 0.0);
  std::printf("%-14s %8zu %8.0f %8.0f %8.0f %8.0f %8.2f %8.0f %8.0f\n", what.c_str(),
              times.ns.size(), bench::percentileOfSorted(times.ns, 0.5),
              bench::percentileOfSorted(times.ns, 0.99), bench::percentileOfSorted(times.ns, 0.999),
              times.ns.back(), sum / count, bench::percentileOfSorted(times.iterations, 0.99),
              times.iterations.back());
}

struct Options {
  std::string scene;
  double seconds = 60.0;
  int repeats = 5;
  double cold = 20.0;  // [s], total duration of the cold ticks
  std::string neighbour = bench::kNeighbours.front();
};

void backToBack(const BuiltScene& built, const Options& options) {
  const bench::Pinned pinned;
  std::map<int, Times> by_primitives;
  Times all;
  std::map<StepStatus, long> unfinished;
  double bound = 0.0;
  for (int repeat = 0; repeat <= options.repeats; ++repeat) {
    SimulatedDevice device({}, {}, explore(built.bounds, options.seconds), 1000.0);
    Reader reader;
    ProxyState state(device.info().limits);
    while (!device.ended()) {
      const HandState hand = device.read();
      const auto start = Clock::now();
      const StepReport report = hapticStep(*built.scene, reader, hand, state, 1e-3);
      const auto end = Clock::now();
      device.write(report.force);
      if (repeat == 0) continue;
      const double ns = std::chrono::duration<double, std::nano>(end - start).count();
      for (Times* times : {&all, &by_primitives[report.primitives]}) {
        times->ns.push_back(ns);
        times->iterations.push_back(report.iterations);
      }
      if (report.status == StepStatus::kConverged) continue;
      ++unfinished[report.status];
      if (report.status == StepStatus::kIterationLimit) {
        bound = std::max(bound, report.error_bound);
      }
    }
  }
  std::printf("%-14s %8s %8s %8s %8s %8s %8s %8s %8s\n", "ticks", "count", "p50", "p99", "p99.9",
              "max", "its mean", "p99", "max");
  print("all", all);
  for (auto& [count, times] : by_primitives) print(std::to_string(count) + " primitives", times);
  for (const auto& [status, count] : unfinished) std::printf("%s %ld\n", wordFor(status), count);
  if (bound > 0.0) std::printf("largest bound where a balance stopped early: %.3g m\n", bound);
}

/// Measures cold ticks: at 1 kHz for four fifths of the time, at 10 kHz for one fifth.
void cold(const BuiltScene& built, const Options& options) {
  constexpr int kTurns = 2;
  std::printf("cold, loops on core %d, their busy neighbour: %s\n", bench::loopCore(),
              options.neighbour.c_str());
  bench::printHead();
  const bench::Neighbour neighbour(options.neighbour);
  for (const double rate : {1000.0, 10000.0}) {
    const double seconds = options.cold * (rate < 5000.0 ? 0.4 : 0.1);  // per loop
    LoopParams params;
    params.rate = rate;
    params.early = 0.0;
    params.realtime.core = bench::loopCore();
    SimulatedDevice device({}, {}, explore(built.bounds, seconds), rate);
    bench::LoopTimes bare;
    bench::LoopTimes asleep;
    for (int turn = 0; turn < kTurns; ++turn) {
      bare.add(bench::runBare(rate, seconds / kTurns, params.realtime));
      asleep.add(bench::runHaptic(device, built.scene, params, seconds / kTurns));
    }
    const std::string at = rate < 5000.0 ? "1 kHz, " : "10 kHz, ";
    bench::printRow(at + "bare", bare);
    bench::printRow(at + "asleep", asleep);
  }
}

int run(const Options& options) {
  const BuiltScene built = buildScene(openScene(options.scene));
  bench::Machine machine = bench::takeMachine(false);
  machine.pinned = bench::Pinned().good();
  std::printf("%s (included)\n", bench::describe(machine).c_str());
  std::printf("%s, %.0f s at 1 kHz, %d times after one warm-up; ns\n", options.scene.c_str(),
              options.seconds, options.repeats);
  backToBack(built, options);
  if (options.cold > 0.0) cold(built, options);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    Options options;
    CLI::App app{"Time of a tick, back to back and cold."};
    app.add_option("scene", options.scene, "a scene or a .vdb")->required();
    app.add_option("seconds", options.seconds, "of the hand, back to back, default 60");
    app.add_option("repeats", options.repeats, "of those, default 5");
    app.add_option("--cold", options.cold, "seconds for cold ticks, default 20; 0: none");
    app.add_option("--neighbour", options.neighbour,
                   "busy on the loop's own core (default), another one, or none")
        ->check(CLI::IsMember(bench::kNeighbours));
    CLI11_PARSE(app, argc, argv);
    return run(options);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_tick: %s\n", e.what());
    return 2;
  }
}
