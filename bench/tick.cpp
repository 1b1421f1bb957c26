/// What does one whole tick cost? Feels a scene with the simulated device and prints the times of
/// single ticks, by how many primitives they balanced, their iterations, and what did not end well.
///
///     palpate_bench_tick SCENE [SECONDS [REPEATS]]
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <map>
#include <numeric>
#include <string>
#include <vector>

#include "bench/machine.h"
#include "palpate/devices/simulated_device.h"
#include "palpate/engine/step.h"
#include "palpate/scenes/scene_file.h"
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

int run(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: palpate_bench_tick SCENE [SECONDS [REPEATS]]\n");
    return 2;
  }
  const double seconds = argc > 2 ? std::atof(argv[2]) : 60.0;
  const int repeats = argc > 3 ? std::atoi(argv[3]) : 5;
  const SceneSpec spec = openScene(argv[1]);
  const BuiltScene built = buildScene(spec);

  std::printf("%s (included)\n", bench::describe(bench::takeMachine()).c_str());
  std::printf("%s, %.0f s at 1 kHz, %d times after one warm-up; ns\n", argv[1], seconds, repeats);

  std::map<int, Times> by_primitives;
  Times all;
  std::map<StepStatus, long> unfinished;
  double bound = 0.0;
  for (int repeat = 0; repeat <= repeats; ++repeat) {
    SimulatedDevice device({}, {}, explore(built.bounds, seconds), 1000.0);
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
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_tick: %s\n", e.what());
    return 2;
  }
}
