/// Compares the methods' speed, accuracy and stability. Finds the largest stable stiffness on a
/// wall and between two planes at 1, 4 and 10 kHz (with --quick, 1 and 4 kHz). Also measures the
/// error of the force and the cost of a balance.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

#include "bench/report.h"
#include "palpate/bench/methods/map_methods.h"
#include "palpate/devices/simulated/stability.h"
#include "palpate/devices/simulated/stability_map.h"
#include "palpate/engine/balance/solver.h"

using namespace palpate;
using nlohmann::ordered_json;

namespace {

constexpr double kStiffness = 500.0;  // [N/m], at which forces are compared
constexpr double kLeast = 20.0;       // [N/m], at which the search starts

/// Returns the largest stable stiffness [N/m] below the first unstable try; 0 if kLeast is
/// unstable.
///
/// @param most   The search upwards ends at this stiffness [N/m]; the result is below most * step.
/// @param step   Factor between tried stiffnesses. Bisection then reduces it to `ratio`.
double largestStable(const MapSetting& setting, const MapContact& contact, const MapMethod& method,
                     double most, double step, double ratio) {
  const auto rests = [&](double k) {
    return tryCoupling(setting, contact, method.make(k, 0.0, 1.0 / setting.rate)).outcome ==
           MapOutcome::kRests;
  };
  double low = 0.0;
  double high = kLeast;
  while (high < most && rests(high)) {
    low = high;
    high *= step;
  }
  if (low == 0.0) return 0.0;
  while (high > ratio * low) {
    const double middle = std::sqrt(low * high);
    (rests(middle) ? low : high) = middle;
  }
  return low;
}

struct Judged {
  double error = 0.0;    ///< RMS error of the force, divided by the force's RMS.
  double cost_ns = 0.0;  ///< Median time of a balance [ns].
};

/// Measures a method along a path that presses and slides, as a hand does.
Judged judge(const MapContact& contact, const MapMethod& method, int steps) {
  MapFeel feel = method.make(kStiffness, 0.0, 1e-3);
  Vec3 proxy = Vec3::Zero();
  bool placed = false;
  double wrong = 0.0;
  double all = 0.0;
  std::vector<double> times;
  for (int i = 0; i < steps; ++i) {
    const double t = 2.0 * M_PI * i / steps;
    const Vec3 probe = contact.place + Vec3(1e-3 * std::sin(3.0 * t), 1e-3 * std::sin(2.0 * t),
                                            1e-3 - 3e-3 * std::pow(std::sin(0.5 * t), 2));
    const auto start = bench::Clock::now();
    const Vec3 force = feel(probe);
    const std::chrono::duration<double, std::nano> spent = bench::Clock::now() - start;
    times.push_back(spent.count());
    if (!placed) proxy = probe;
    placed = true;
    const SolveResult exact = solveProxy(probe, kStiffness, contact.primitives, proxy, {1e-10});
    proxy = probe + exact.offset;
    wrong += (force - kStiffness * exact.offset).squaredNorm();
    all += (kStiffness * exact.offset).squaredNorm();
  }
  std::nth_element(times.begin(), times.begin() + steps / 2, times.end());
  return {std::sqrt(wrong / all), times[static_cast<std::size_t>(steps / 2)]};
}

int run(bool quick, const std::string& output) {
  const bench::Machine machine = bench::takeMachine();
  const double step = quick ? 1.6 : 1.25;
  const double ratio = quick ? 1.1 : 1.01;
  const std::vector<double> rates =
      quick ? std::vector<double>{1000.0, 4000.0} : std::vector<double>{1000.0, 4000.0, 10000.0};
  ordered_json results = ordered_json::array();
  for (const bool wall : {true, false}) {
    const MapContact contact = wall ? wallContact() : troughContact(20.0);
    const char* const where = wall ? "a wall" : "two planes, 20 degrees";
    for (const MapMethod& method : methodsOver(contact)) {
      bench::tell(std::string(where) + ", " + method.name);
      const Judged judged = judge(contact, method, quick ? 200 : 4000);
      ordered_json one{{"contact", where},
                       {"method", method.name},
                       {"force_error", bench::rounded(judged.error)},
                       {"cost_ns", bench::rounded(judged.cost_ns)},
                       {"stable", ordered_json::array()}};
      for (const double rate : rates) {
        MapSetting setting;
        setting.rate = rate;
        setting.arm.delay = 1.0 / rate;
        // Coulomb friction would stop a small kick even above the stability limit.
        setting.arm.coulomb = 0.0;
        setting.arm.encoder = 1e-7;
        setting.seconds = quick ? 1.0 : 3.0;
        const double formula = stableStiffness(setting.arm, setting.grip, rate);
        const double found = largestStable(setting, contact, method, 4.0 * formula, step, ratio);
        one["stable"].push_back({{"rate", rate},
                                 {"stiffness", bench::rounded(found)},
                                 {"formula", bench::rounded(formula)}});
      }
      results.push_back(one);
    }
  }
  bench::tell("");
  bench::writeResult({{"machine", bench::asJson(machine)},
                      {"quick", quick},
                      {"stiffness", kStiffness},
                      {"results", results}},
                     output);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    bool quick = false;
    std::string output;
    CLI::App app{"Largest stable stiffness, force error and cost, method by method; JSON."};
    app.add_flag("--quick", quick, "short runs, no care for times");
    app.add_option("--output", output, "a file instead of standard output");
    CLI11_PARSE(app, argc, argv);
    return run(quick, output);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_stability_accuracy: %s\n", e.what());
    return 2;
  }
}
