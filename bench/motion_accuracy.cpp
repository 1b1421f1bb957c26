/// Measures the cost of a tick, and the proxy's distance from known surfaces and streams. Compares
/// the engine with textbook methods that keep no reference (motion_methods.h), at several speeds.
///
///     palpate_bench_motion_accuracy > motion_accuracy.json
///     bench/motion_accuracy_chart.py motion_accuracy.json docs/charts
#include <algorithm>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "bench/machine.h"
#include "bench/motion_methods.h"
#include "bench/report.h"
#include "tests/support/motion_problems.h"
#include "tests/support/percentiles.h"
#include "tests/support/random.h"
#include "tests/support/rubbing.h"
#include "tests/support/theorem.h"

namespace {

using namespace palpate;
using namespace palpate::bench;
using nlohmann::ordered_json;

struct Options {
  bool quick = false;
  std::string output;
  std::vector<std::string> flows;  ///< .vdb files.
  std::string scan;                ///< a CT scan as .vdb, on which the hand slides

  [[nodiscard]] std::vector<double> speeds() const {
    return quick ? std::vector{0.5} : std::vector{0.05, 0.5, 1.0, 2.0};  // [m/s]
  }
  // Length of the path on a surface [voxels].
  [[nodiscard]] double way() const { return quick ? 1000.0 : 4800.0; }
  [[nodiscard]] std::size_t rounds() const { return quick ? 1 : 5; }
  [[nodiscard]] std::size_t starts() const { return quick ? 2 : 6; }
  // Largest length of the path along a stream [voxels].
  [[nodiscard]] double length() const { return quick ? 96.0 : 256.0; }
};

constexpr double kStrength = 3.0;        // [N], of a surface
constexpr double kStreamStrength = 1.0;  // [N], of a stream
constexpr double kPull = 1.0;            // distance of the hand beside a stream [voxels]
constexpr int kSubsteps = 16;            // largest number for the engine

/// A method at one setting. `on` makes the method for a problem.
template <class Problem>
struct Contender {
  std::string method;
  /// For the engine, the tolerance [voxels]; for other methods, sub-steps or repetitions.
  std::string setting;
  std::function<Stepper(const Problem&)> on;
};

StepParams within(double tolerance) {
  StepParams step;
  step.tolerance_voxels = tolerance;
  step.max_substeps = kSubsteps;
  return step;
}

template <class Method>
Stepper stepperOf(std::shared_ptr<Method> method, double level = 0.0) {
  return [method = std::move(method), level](const Vec3& hand) {
    const methods::Moved moved = method->tick(hand);
    Ticked out;
    out.proxy = moved.proxy;
    if (moved.held) out.force = kMotionStiffness * (moved.proxy - hand);
    out.samples = moved.reads;
    out.cells = moved.cells;
    out.level = level;
    return out;
  };
}

const std::vector<std::pair<std::string, double>> kTolerances{
    {"0.1", 0.1}, {"0.01", 0.01}, {"1e-3", 1e-3}, {"1e-4", 1e-4}};

std::vector<Contender<SurfaceMotion>> surfaceContenders() {
  std::vector<Contender<SurfaceMotion>> out;
  out.reserve(12);
  for (const auto& [word, tolerance] : kTolerances) {
    out.push_back({"palpate", word, [t = tolerance](const SurfaceMotion& motion) {
                     return engineOn(motion, ModeKind::kIsosurface, within(t), kStrength);
                   }});
  }
  const auto add = [&](const std::string& method, int setting, const methods::SurfaceRule& rule) {
    out.push_back({method, std::to_string(setting), [rule](const SurfaceMotion& motion) {
                     return stepperOf(std::make_shared<methods::MemorylessSurface>(
                                          std::get<0>(motion.field), motion.level,
                                          motion.solid == Solid::kBelow ? 1.0 : -1.0,
                                          kStrength / kMotionStiffness, rule),
                                      motion.level);
                   }});
  };
  for (const int substeps : {1, 4, 16, 64}) add("plane", substeps, {substeps, 0});
  for (const int times : {1, 2, 3, 5}) add("midpoint", times, {1, times});
  return out;
}

std::vector<Contender<Stream>> streamContenders() {
  std::vector<Contender<Stream>> out;
  out.reserve(12);
  for (const auto& [word, tolerance] : kTolerances) {
    out.push_back({"palpate", word,
                   [t = tolerance](const Stream& stream) { return engineOn(stream, within(t)); }});
  }
  const auto add = [&](const std::string& method, int substeps, methods::Along along) {
    out.push_back({method, std::to_string(substeps), [=](const Stream& stream) {
                     return stepperOf(std::make_shared<methods::MemorylessStream>(
                         std::get<1>(stream.field), kStreamStrength / kMotionStiffness,
                         methods::StreamRule{along, substeps}));
                   }});
  };
  for (const int substeps : {1, 4, 16, 64}) add("line", substeps, methods::Along::kTangent);
  add("midpoint", 1, methods::Along::kMidpoint);
  for (const int substeps : {1, 4, 16}) add("RK4", substeps, methods::Along::kRk4);
  return out;
}

ordered_json ofRounds(const std::vector<double>& ns) {
  return {{"median", rounded(percentile(ns, 0.5))},
          {"p10", rounded(percentile(ns, 0.1))},
          {"p90", rounded(percentile(ns, 0.9))}};
}

/// Runs all methods in all rounds. Each round begins with the next method, so that other work of
/// the machine affects all equally. Writes the rows of the first round, with the times of all
/// rounds.
template <class Problem, class Run>
void compare(const std::vector<Contender<Problem>>& contenders, const Options& options,
             ordered_json& results, const Run& run) {
  std::vector<ordered_json> rows(contenders.size());
  std::vector<std::vector<double>> times(contenders.size());
  for (std::size_t round = 0; round < options.rounds(); ++round) {
    for (std::size_t i = 0; i < contenders.size(); ++i) {
      const std::size_t c = (i + round) % contenders.size();
      double ns = 0.0;
      ordered_json row = run(contenders[c], round, ns);
      if (round == 0) rows[c] = std::move(row);
      times[c].push_back(ns);
    }
  }
  for (std::size_t i = 0; i < contenders.size(); ++i) {
    rows[i]["ns"] = ofRounds(times[i]);
    results.push_back(std::move(rows[i]));
  }
}

struct Surface {
  std::string name;
  std::function<SurfaceMotion()> make;
};

const std::vector<Surface> kSurfaces{
    {"sphere, radius 40", [] { return sphereMotion("level set", 40.0, 2.56); }},
    {"sphere, radius 8", [] { return sphereMotion("level set", 8.0, 2.56); }},
    {"sphere, radius 3.5", [] { return sphereMotion("level set", 3.5, 1.5); }},
    {"sphere in fog, radius 40", [] { return sphereMotion("fog 6", 40.0, 2.56); }},
    {"inside of a sphere, radius 40", [] { return hollowMotion(40.0, 2.56); }},
    {"torus, radii 30 and 12", [] { return torusMotion(30.0, 12.0, 2.6); }},
    {"cube, over its edges", [] { return cubeMotion(2.56, true); }},
    {"hollow cube, into its corners", [] { return cubeMotion(2.56, true, true); }}};

void measureSurface(const Surface& surface, const Options& options, ordered_json& results) {
  const SurfaceMotion motion = surface.make();
  const auto contenders = surfaceContenders();
  for (const double speed : options.speeds()) {
    tell(surface.name + ", " + std::to_string(speed).substr(0, 4) + " m/s");
    const double laps = options.way() / motion.lap;
    compare(contenders, options, results, [&](const auto& contender, std::size_t, double& ns) {
      const MotionResult r = feelSurface(motion, contender.on(motion), speed, laps);
      ns = r.nanoseconds;
      return ordered_json{{"case", surface.name},        {"speed", speed},
                          {"method", contender.method},  {"setting", contender.setting},
                          {"off", rounded(r.off_max)},   {"off_rms", rounded(r.off_rms)},
                          {"true", rounded(r.true_max)}, {"floor", rounded(motion.floor)},
                          {"reads", rounded(r.samples)}, {"most_reads", r.most_samples},
                          {"capped", rounded(r.capped)}, {"lost", rounded(r.lost)}};
    });
  }
}

void measureStreams(const std::string& name, const std::vector<Stream>& streams,
                    const Options& options, ordered_json& results) {
  const auto contenders = streamContenders();
  double longest = 0.0;
  for (const Stream& stream : streams) longest = std::max(longest, stream.length());
  for (const double speed : options.speeds()) {
    tell(name + ", " + std::to_string(speed).substr(0, 4) + " m/s");
    compare(contenders, options, results,
            [&](const auto& contender, std::size_t round, double& ns) {
              std::vector<double> off;
              std::vector<double> departures;
              std::vector<double> times;
              double reads = 0.0;
              double most = 0.0;
              double capped = 0.0;
              const auto share = 1.0 / static_cast<double>(streams.size());
              for (const Stream& stream : streams) {
                const StreamResult r =
                    feelStream(stream, contender.on(stream), speed, kPull, round == 0);
                off.push_back(r.off_max);
                departures.push_back(r.departures);
                times.push_back(r.nanoseconds);
                reads += share * r.samples;
                most = std::max(most, r.most_samples);
                capped += share * r.capped;
              }
              ns = percentile(times, 0.5);
              return ordered_json{{"case", name},
                                  {"speed", speed},
                                  {"method", contender.method},
                                  {"setting", contender.setting},
                                  {"paths", streams.size()},
                                  {"longest", rounded(longest)},
                                  {"off", rounded(percentile(off, 1.0))},
                                  {"off_median", rounded(percentile(off, 0.5))},
                                  {"departures", rounded(percentile(departures, 1.0))},
                                  {"departures_median", rounded(percentile(departures, 0.5))},
                                  {"reads", rounded(reads)},
                                  {"most_reads", most},
                                  {"capped", rounded(capped)}};
            });
  }
}

/// Returns a file's streams with the hand on the near side of the centre of curvature.
std::vector<Stream> streamsOf(const std::string& file, const Options& options) {
  std::vector<Stream> streams = streamsOfFile(file, 4 * options.starts(), options.length());
  std::erase_if(streams, [](const Stream& s) { return !(s.mostBend(kPull) < kMostBend); });
  if (streams.empty())
    throw std::runtime_error(file + ": no stream of 8 voxels, bent little enough to follow");
  return streams;
}

/// Returns the time per tick of a step that does nothing: the cost of the loop and the call [ns].
double timeNothing(const Options& options) {
  const SurfaceMotion motion = sphereMotion("level set", 3.5, 1.5);
  const Stepper nothing = [](const Vec3& hand) {
    Ticked out;
    out.proxy = hand;
    return out;
  };
  return feelSurface(motion, nothing, 0.5, options.way() / motion.lap).nanoseconds;
}

/// Measures the force noise of a hand on a scanned head's skin, with both proxies of rubbing.h.
/// Returns an empty array if no scan is given.
ordered_json rubOn(const Options& options) {
  constexpr double kSkin = -300.0;  // [HU]
  constexpr double kScale = 1e-3;   // metres per unit of the scan: millimetres
  ordered_json rows = ordered_json::array();
  if (options.scan.empty()) return rows;
  for (const double speed : {0.02, 0.05, 0.2}) {
    tell("rubbing, " + std::to_string(speed).substr(0, 4) + " m/s");
    const Rubbing r = rub(options.scan, kSkin, kScale, speed);
    rows.push_back({{"speed", speed},
                    {"slides", r.slides},
                    {"ticks", r.ticks},
                    {"force", rounded(r.force)},
                    {"reads", rounded(r.samples)},
                    {"capped", rounded(r.unfinished)},
                    {"injected", rounded(r.injected)},
                    {"buzz", rounded(r.engine.buzz)},
                    {"given", rounded(r.engine.given)},
                    {"buzz_held", rounded(r.held.buzz)},
                    {"given_held", rounded(r.held.given)}});
  }
  return rows;
}

int run(const Options& options) {
  const Machine machine = takeMachine();
  const double nothing = timeNothing(options);
  ordered_json surfaces = ordered_json::array();
  for (const Surface& surface : kSurfaces) measureSurface(surface, options, surfaces);

  ordered_json streams = ordered_json::array();
  for (const int wavelength : {16, 32}) {
    if (options.quick && wavelength == 32) continue;
    const std::string voxels = ", " + std::to_string(wavelength) + " voxels";
    const auto measure = [&](const std::string& name, const auto& flow) {
      measureStreams(name + voxels,
                     streamsOfFlow(flow, wavelength, options.length(), options.starts(), kPull),
                     options, streams);
    };
    measure("ABC flow", abcFlow(wavelength));
    measure("Taylor-Green", taylorGreen(wavelength));
  }
  for (const std::string& file : options.flows) {
    measureStreams(std::filesystem::path(file).stem().string(), streamsOf(file, options), options,
                   streams);
  }
  const ordered_json rubbing = rubOn(options);
  tell("");

  writeResult({{"machine", asJson(machine)},
               {"options",
                {{"quick", options.quick},
                 {"rounds", options.rounds()},
                 {"way", options.way()},
                 {"paths", options.starts()},
                 {"length", options.length()},
                 {"substeps", kSubsteps},
                 {"nothing_ns", rounded(nothing)}}},
               {"surfaces", surfaces},
               {"streams", streams},
               {"rubbing", rubbing}},
              options.output);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    proving() = false;
    Options options;
    CLI::App app{"Time of a tick against the proxy's distance from its exact course; JSON."};
    app.add_flag("--quick", options.quick, "one speed, few ticks, no care for times");
    app.add_option("--flow", options.flows, "a .vdb with one grid of vectors; again for more");
    app.add_option("--scan", options.scan, "a CT in Hounsfield units and millimetres, as .vdb");
    app.add_option("--output", options.output, "a file instead of standard output");
    CLI11_PARSE(app, argc, argv);
    return run(options);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_motion_accuracy: %s\n", e.what());
    return 2;
  }
}
