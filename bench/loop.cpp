/// Measures the cost of starting ticks on time. Runs the haptic thread over scenes at 1 and 10 kHz,
/// in turns with a bare loop, beside the same other work (Neighbour in bench/cold.h). The thread
/// sleeps until each tick, or wakes early and warms up its caches (LoopParams::early).
///
///     palpate_bench_loop SCENE... [--seconds S] [--turns N] [--neighbour own|other|none]
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "bench/cold.h"
#include "bench/machine.h"
#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/scenes/library/scene_file.h"

namespace {

using namespace palpate;

struct Options {
  std::vector<std::string> scenes;
  double seconds = 4.0;
  int turns = 3;
  std::string neighbour = bench::kNeighbours.front();
};

/// One variant of the haptic thread, with its times. All turns together cover the hand's path once.
struct Loop {
  std::string name;
  LoopParams params;
  SimulatedDevice device;
  bench::LoopTimes times;
};

void measure(const BuiltScene& built, double rate, const Options& options) {
  const bench::Neighbour neighbour(options.neighbour);
  const auto loop = [&](const std::string& name, double early) {
    LoopParams params;
    params.rate = rate;
    params.early = early;
    params.realtime.core = bench::loopCore();
    const HandTarget hand = explore(built.bounds, options.turns * options.seconds);
    return Loop{name, params, SimulatedDevice({}, {}, hand, rate), {}};
  };
  const double early = std::min(kEarly, 0.25 / rate);
  bench::LoopTimes bare;
  std::array loops{loop("asleep", 0.0),
                   loop("early, " + std::to_string(std::lround(1e6 * early)) + " us", early)};
  for (int turn = 0; turn < options.turns; ++turn) {
    bare.add(bench::runBare(rate, options.seconds, loops.front().params.realtime));
    for (Loop& each : loops) {
      each.times.add(bench::runHaptic(each.device, built.scene, each.params, options.seconds));
    }
  }
  const std::string at = std::to_string(std::lround(1e-3 * rate)) + " kHz, ";
  bench::printRow(at + "bare", bare);
  for (const Loop& each : loops) bench::printRow(at + each.name, each.times);
  std::fflush(stdout);
}

int run(const Options& options) {
  std::printf("%s\n", bench::describe(bench::takeMachine(false)).c_str());
  std::printf("%d turns of %g s each, loops on core %d, their busy neighbour: %s\n", options.turns,
              options.seconds, bench::loopCore(), options.neighbour.c_str());
  bench::printHead();
  for (const std::string& scene : options.scenes) {
    const BuiltScene built = buildScene(openScene(scene));
    std::printf("%s\n", scene.c_str());
    for (const double rate : {1000.0, 10000.0}) measure(built, rate, options);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    Options options;
    CLI::App app{"Ticks, wake-ups and cost of the loop, asleep until a tick's time and early."};
    app.add_option("scenes", options.scenes, "scenes or .vdb")->required();
    app.add_option("--seconds", options.seconds, "of a run, default 4");
    app.add_option("--turns", options.turns, "of each kind of run, default 3");
    app.add_option("--neighbour", options.neighbour,
                   "busy on the loop's own core (default), another one, or none")
        ->check(CLI::IsMember(bench::kNeighbours));
    CLI11_PARSE(app, argc, argv);
    return run(options);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_loop: %s\n", e.what());
    return 2;
  }
}
