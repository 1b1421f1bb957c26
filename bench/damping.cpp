/// Measures how the averaging time of the coupling's damper affects two results: the force noise
/// from encoder steps, and the largest stable stiffness.
#include <cstdio>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "bench/report.h"
#include "palpate/devices/simulated/stability.h"
#include "tests/support/damping_buzz.h"

using namespace palpate;
using nlohmann::ordered_json;

namespace {

void run(const std::string& output) {
  const bench::Machine machine = bench::takeMachine();
  const std::vector<double> times{0.0, 0.5e-3, 1e-3, 2e-3, 4e-3};  // 0 means one tick
  const GripParams released{0.0, 0.0};
  ordered_json results = ordered_json::array();
  for (const double rate : {1000.0, 4000.0, 10000.0}) {
    for (const double damping : {0.5, 2.0}) {
      ordered_json one{{"rate", rate},
                       {"damping", damping},
                       {"undamped", bench::rounded(bench::buzzOf({rate, 30e-6, 0.0}))},
                       {"times", ordered_json::array()}};
      for (const double time : times) {
        one["times"].push_back(
            {{"time", time},
             {"buzz", bench::rounded(bench::buzzOf({rate, 30e-6, damping, time}))},
             {"released", bench::rounded(stableStiffness({}, released, rate, damping, time))},
             {"relaxed", bench::rounded(stableStiffness({}, {}, rate, damping, time))}});
      }
      results.push_back(one);
    }
  }
  bench::writeResult({{"machine", bench::asJson(machine)}, {"results", results}}, output);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    std::string output;
    CLI::App app{"What damping makes of an encoder's steps, by how long it looks back; JSON."};
    app.add_option("--output", output, "a file instead of standard output");
    CLI11_PARSE(app, argc, argv);
    run(output);
    return 0;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_damping: %s\n", e.what());
    return 2;
  }
}
