/// Measures the cost of a volume that does not fit into memory. A hand moves in real time along the
/// skin of a large head. The head is read through the window or is completely in memory, in turns.
///
///     palpate_bench_window DATA [--voxel MM] [--times N] [--pairs N] [--out RESULT.json]
///
/// DATA: folder with VTK's head (ct_headsq). Bricks are in --folder and are removed at the end.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <system_error>
#include <thread>
#include <unistd.h>
#include <vector>

#include <CLI/CLI.hpp>

#include "bench/cold.h"
#include "bench/machine.h"
#include "bench/report.h"
#include "palpate/devices/simulated/path_device.h"
#include "palpate/scenes/library/build_scene.h"
#include "tests/support/fine_head.h"
#include "tests/support/percentiles.h"

namespace {

using namespace palpate;
using bench::percentile;
using test::FineHead;
using Json = nlohmann::ordered_json;
namespace fs = std::filesystem;

constexpr double kTick = 1e-3;   // [s]
constexpr double kDepth = 3.0;   // [mm], of the hand below the skin
constexpr double kBefore = 1.2;  // [s], in which the hand is beside the head and then moves into it
constexpr double kMegabyte = 1024.0 * 1024.0;

/// Returns the resident memory of this process [bytes].
double used() {
  std::ifstream stream("/proc/self/statm");
  double all = 0.0;
  double resident = 0.0;
  stream >> all >> resident;
  return resident * static_cast<double>(sysconf(_SC_PAGESIZE));
}

class Ticks final : public TickSink {
 public:
  struct Row {
    double time = 0.0;  ///< [s]
    double ns = 0.0;
    double force = 0.0;  ///< [N]
    bool coarse = false;
    bool missed = false;
  };
  explicit Ticks(std::size_t most) { rows_.reserve(most); }
  void take(const Telemetry& tick, const ProxyState& /*state*/) noexcept override {
    if (rows_.size() == rows_.capacity()) return;
    rows_.push_back({static_cast<double>(tick.tick) * kTick, static_cast<double>(tick.tick_ns),
                     tick.report.force.norm(), tick.report.coarse, tick.missed});
  }
  [[nodiscard]] std::vector<Row> felt() const {
    std::vector<Row> out;
    for (const Row& row : rows_) {
      if (row.time > kBefore) out.push_back(row);
    }
    return out;
  }

 private:
  std::vector<Row> rows_;
};

struct Held {
  double time;
  WindowState state;
};

struct Run {
  std::vector<Ticks::Row> ticks;
  std::vector<Held> held;
  /// True if a fault cut the run, usually because the machine kept the loop from its core for 5 ms.
  bool cut = false;
};

std::vector<PathPoint> wayOf(const FineHead& head, double speed, double length) {
  const std::vector<Vec3> way = head.way(length, speed * kTick, kDepth);
  std::vector<PathPoint> path;
  const Vec3 out = way.front() * (1.0 + 0.02 / way.front().norm());
  path.push_back({0.0, out});
  path.push_back({kBefore - 0.2, out});
  for (std::size_t i = 0; i < way.size(); ++i) {
    path.push_back({kBefore + kTick * static_cast<double>(i), way[i]});
  }
  return path;
}

Run feel(const std::shared_ptr<const Scene>& scene, const std::vector<PathPoint>& path,
         const BrickWindow* window) {
  PathDevice device(path, 1.0 / kTick);
  Ticks ticks(static_cast<std::size_t>(path.back().t / kTick) + 100);
  LoopParams params;
  params.realtime.core = bench::loopCore();
  HapticThread thread(device, params, &ticks);
  thread.publish(scene);
  const auto begin = std::chrono::steady_clock::now();
  Run run;
  while (thread.running()) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    if (window == nullptr) continue;
    const std::chrono::duration<double> since = std::chrono::steady_clock::now() - begin;
    run.held.push_back({since.count(), window->state()});
  }
  run.cut = thread.latest().fault != Fault::kNone;
  thread.stop();
  run.ticks = ticks.felt();
  return run;
}

/// Repeats the run, at most five times, until no fault cuts it.
Run feelWhole(const std::shared_ptr<const Scene>& scene, const std::vector<PathPoint>& path,
              const BrickWindow* window) {
  constexpr int kMost = 5;
  Run run;
  for (int i = 0; i < kMost; ++i) {
    run = feel(scene, path, window);
    if (!run.cut) return run;
    std::printf(
        "a fault cut a run, usually because the loop was late by 5 ms; once more, at most 5 "
        "times\n");
  }
  return run;
}

struct Figures {
  std::vector<double> us;
  double coarse = 0.0;
  double late = 0.0;
  double step = 0.0;   ///< Largest growth of the force from one tick to the next [N].
  double force = 0.0;  ///< Mean force [N].

  explicit Figures(const std::vector<Ticks::Row>& ticks) {
    double last = ticks.front().force;
    for (const Ticks::Row& row : ticks) {
      us.push_back(1e-3 * row.ns);
      coarse += row.coarse ? 1.0 : 0.0;
      late += row.missed ? 1.0 : 0.0;
      step = std::max(step, row.force - last);
      last = row.force;
      force += row.force;
    }
    coarse /= static_cast<double>(ticks.size());
    force /= static_cast<double>(ticks.size());
  }
};

/// Returns each tick's median over several runs, which excludes delays by the machine.
std::vector<double> tickByTick(const std::vector<std::vector<Ticks::Row>>& runs) {
  std::vector<double> out;
  for (std::size_t i = 0;; ++i) {
    std::vector<double> one;
    for (const auto& run : runs) {
      if (i >= run.size()) return out;
      one.push_back(1e-3 * run[i].ns);
    }
    if (one.empty()) return out;
    out.push_back(percentile(one, 0.5));
  }
}

std::vector<Ticks::Row> together(const std::vector<std::vector<Ticks::Row>>& runs) {
  std::vector<Ticks::Row> out;
  for (const auto& run : runs) out.insert(out.end(), run.begin(), run.end());
  return out;
}

Json jsonOf(const Figures& of) {
  return {{"p50_us", bench::rounded(percentile(of.us, 0.5))},
          {"p99_us", bench::rounded(percentile(of.us, 0.99))},
          {"p999_us", bench::rounded(percentile(of.us, 0.999))},
          {"max_us", bench::rounded(percentile(of.us, 1.0))},
          {"late", of.late},
          {"coarse_share", bench::rounded(of.coarse)},
          {"step_n", bench::rounded(of.step)},
          {"force_n", bench::rounded(of.force)}};
}

void print(const std::string& what, const Json& of) {
  std::printf("| %s | %.2f | %.2f | %.2f | %.1f | %.0f | %.1f %% | %.2f | %.2f |\n", what.c_str(),
              of["p50_us"].get<double>(), of["p99_us"].get<double>(), of["p999_us"].get<double>(),
              of["max_us"].get<double>(), of["late"].get<double>(),
              100.0 * of["coarse_share"].get<double>(), of["step_n"].get<double>(),
              of["force_n"].get<double>());
  std::fflush(stdout);
}

void printHead() {
  std::puts(
      "| felt | p50 us | p99 us | p99.9 us | worst us | late ticks | coarse | step N | force N |\n"
      "|---|---|---|---|---|---|---|---|---|");
}

/// Returns memory, share of coarse ticks and tick times along the path, in pieces of `width` [s].
Json seriesOf(const Run& run, double width) {
  Json series = Json::array();
  std::size_t held = 0;
  for (std::size_t begin = 0; begin < run.ticks.size();) {
    std::size_t end = begin;
    while (end < run.ticks.size() && run.ticks[end].time < run.ticks[begin].time + width) ++end;
    const Figures of({run.ticks.begin() + static_cast<std::ptrdiff_t>(begin),
                      run.ticks.begin() + static_cast<std::ptrdiff_t>(end)});
    while (held + 1 < run.held.size() && run.held[held].time < run.ticks[begin].time) ++held;
    const WindowState& state = run.held[held].state;
    series.push_back({{"s", bench::rounded(run.ticks[begin].time - kBefore)},
                      {"resident", state.resident},
                      {"slots", state.slots},
                      {"fetched", state.fetched},
                      {"coarse_share", bench::rounded(of.coarse)},
                      {"p50_us", bench::rounded(percentile(of.us, 0.5))},
                      {"max_us", bench::rounded(percentile(of.us, 1.0))}});
    begin = end;
  }
  return series;
}

struct Options {
  std::string data;
  std::string folder;
  std::string out;
  double voxel = 0.3;  // [mm]
  double times = 16.0;
  int pairs = 10;
};

SceneSpec specOf(const Options& options) {
  SceneSpec spec;
  VolumeSpec& head = spec.volumes["head"];
  head.file = options.folder;
  head.place.kind = PlaceSpec::Kind::kUnit;
  head.place.size = 1e-3;
  spec.coupling.stiffness = 500.0;
  spec.graph.modes.resize(1);
  ModeSpec& skin = spec.graph.modes[0];
  skin.kind = ModeKind::kIsosurface;
  skin.of = "head";
  skin.value = 500.0;
  skin.strength = 6.0;
  skin.friction = 0.3;
  return spec;
}

void measure(const Options& options) {
  const FineHead head(options.data, options.voxel);
  const auto writing = std::chrono::steady_clock::now();
  const BrickReport report = writeBricks(options.folder, head.input());
  const std::chrono::duration<double> wrote = std::chrono::steady_clock::now() - writing;
  const double whole = 4.0 * head.count(0) * head.count(1) * head.count(2);
  std::printf("%d x %d x %d voxels of %g mm, %.0f MB; %llu bricks of %.0f MB written in %.1f s\n",
              head.count(0), head.count(1), head.count(2), options.voxel, whole / kMegabyte,
              static_cast<unsigned long long>(report.written),
              static_cast<double>(report.manifest.storedBytes()) / kMegabyte, wrote.count());
  SceneSpec spec = specOf(options);
  const double budget = whole / options.times;
  spec.volumes["head"].budget_mb = budget / kMegabyte;

  Json result;
  result["machine"] = bench::asJson(bench::takeMachine(/*pin=*/false));
  // The first run, which allocates the loop's own memory such as its locked stack, is not measured.
  (void)feel(nullptr, {{0.0, Vec3::Zero()}, {0.1, Vec3::Zero()}}, nullptr);
  const double before = used();
  BuiltScene through = buildScene(spec);
  const BrickWindow& window = *through.windows.at("head");
  // `volumes` holds the coarsest level a second time.
  const double looked_at = static_cast<double>(through.volumes.at("head")->memory());
  const std::vector<PathPoint> slow = wayOf(head, 0.3, 1.8);
  const std::vector<PathPoint> fast = wayOf(head, 2.0, 6.0);
  const Run at_first = feelWhole(through.scene, slow, &window);
  const Run in_haste = feelWhole(through.scene, fast, &window);
  const double memory = used() - before - looked_at;
  std::printf(
      "budget %.1f MB: %llu bricks; memory %.1f MB by the system, %.1f MB by its own word\n",
      budget / kMegabyte, static_cast<unsigned long long>(window.state().slots), memory / kMegabyte,
      static_cast<double>(window.state().bytes) / kMegabyte);
  result["whole_mb"] = bench::rounded(whole / kMegabyte);
  result["budget_mb"] = bench::rounded(budget / kMegabyte);
  result["memory_mb"] = bench::rounded(memory / kMegabyte);
  result["slow"] = seriesOf(at_first, 0.05);
  result["fast"] = seriesOf(in_haste, 0.05);

  SceneSpec all = spec;
  all.volumes["head"].budget_mb.reset();
  all.volumes["head"].volume = loadBricks(options.folder);
  const BuiltScene in_memory = buildScene(all);
  printHead();
  result["pairs"] = Json::array();
  std::vector<double> ratio;
  std::vector<std::vector<Ticks::Row>> of_window;
  std::vector<std::vector<Ticks::Row>> of_whole;
  for (int pair = 0; pair < options.pairs; ++pair) {
    Json both;
    const auto wholly = [&] {
      const Run run = feelWhole(in_memory.scene, slow, nullptr);
      of_whole.push_back(run.ticks);
      both["whole"] = jsonOf(Figures(run.ticks));
    };
    const auto streamed = [&] {
      const Run run = feelWhole(through.scene, slow, &window);
      of_window.push_back(run.ticks);
      both["window"] = jsonOf(Figures(run.ticks));
    };
    if (pair % 2 == 0) wholly();
    streamed();
    if (pair % 2 != 0) wholly();
    ratio.push_back(both["window"]["p999_us"].get<double>() /
                    both["whole"]["p999_us"].get<double>());
    result["pairs"].push_back(both);
  }
  if (options.pairs > 0) {
    result["all"] = {{"whole", jsonOf(Figures(together(of_whole)))},
                     {"window", jsonOf(Figures(together(of_window)))}};
    print("0.3 m/s, in memory", result["all"]["whole"]);
    print("0.3 m/s, through the window", result["all"]["window"]);
  }
  std::vector<Ticks::Row> rushed = in_haste.ticks;
  result["haste"] = {{"window", jsonOf(Figures(rushed))}};
  const Run fast_whole = feelWhole(in_memory.scene, fast, nullptr);
  result["haste"]["whole"] = jsonOf(Figures(fast_whole.ticks));
  print("2 m/s, in memory", result["haste"]["whole"]);
  print("2 m/s, through the window", result["haste"]["window"]);
  if (!ratio.empty()) {
    std::printf(
        "p99.9 through the window, of in memory, %zu pairs: %.2f in the median, %.2f to %.2f\n",
        ratio.size(), percentile(ratio, 0.5), percentile(ratio, 0.0), percentile(ratio, 1.0));
    result["p999_ratio"] = bench::rounded(percentile(ratio, 0.5));
  }
  if (!of_whole.empty()) {
    const std::vector<double> whole_us = tickByTick(of_whole);
    const std::vector<double> window_us = tickByTick(of_window);
    for (const auto& [name, p] : {std::pair{"p50", 0.5}, {"p99", 0.99}, {"p99.9", 0.999}}) {
      const double a = percentile(whole_us, p);
      const double b = percentile(window_us, p);
      std::printf("%s of ticks in their medians over the pairs: %.2f us in memory, %.2f us, %.2f\n",
                  name, a, b, b / a);
      result["ticks"][name] = {bench::rounded(a), bench::rounded(b)};
    }
  }
  if (!options.out.empty()) bench::writeResult(result, options.out);
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{"What does it cost to feel a volume that is not in memory?"};
  Options options;
  options.folder = (fs::temp_directory_path() / ("window-" + std::to_string(getpid()))).string();
  app.add_option("DATA", options.data, "With the folder ct_headsq")->required();
  app.add_option("--voxel", options.voxel, "Of the head [mm]; default 0.3, 835 MB")
      ->check(CLI::PositiveNumber);
  app.add_option("--times", options.times, "The volume has so many times the budget; default 16")
      ->check(CLI::PositiveNumber);
  app.add_option("--pairs", options.pairs, "Runs each way; default 10");
  app.add_option("--folder", options.folder, "Where to write; removed at the end");
  app.add_option("--out", options.out, "JSON, for window_chart.py");
  CLI11_PARSE(app, argc, argv);
  int status = 0;
  try {
    measure(options);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_window: %s\n", e.what());
    status = 2;
  }
  std::error_code error;
  fs::remove_all(options.folder, error);
  return status;
}
