/// Measures the cost of many volumes (ticks, memory, build time) by number, overlap and size.
///
///     palpate_bench_scale [--quick] [--pairs N] [--only WHAT] [--scene SCENE]... [--out
///     RESULT.json]
///
/// Compares the ticks of two scenes in pairs of runs, in alternating order. Scenes are built on all
/// cores; the thread that ticks stays on one core.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <exception>
#include <fstream>
#include <malloc.h>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <unistd.h>
#include <vector>

#include <CLI/CLI.hpp>
#include <openvdb/tools/LevelSetSphere.h>

#include "bench/report.h"
#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/library/build_scene.h"
#include "palpate/scenes/library/scene_file.h"
#include "tests/support/percentiles.h"
#include "tests/support/reference_solver.h"
#include "tests/support/vdb_files.h"

namespace {

using namespace palpate;
using bench::Clock;
using bench::rounded;
using nlohmann::ordered_json;

constexpr double kVoxel = 1e-3;   // [m]
constexpr double kRadius = 0.02;  // [m], of a ball
constexpr double kRoom = 0.5;     // [m], from the middle of the room to a wall
constexpr double kDt = 1e-3;

struct Options {
  bool quick = false;
  int pairs = 9;
  std::string only;  // name of the only table to measure; empty: all tables
  std::vector<std::string> scenes;
  std::string out;
};

double seconds(Clock::time_point from) {
  return std::chrono::duration<double>(Clock::now() - from).count();
}

/// Returns the resident memory of this process [bytes].
double residentMemory() {
  malloc_trim(0);
  std::ifstream file("/proc/self/statm");
  double all = 0.0;
  double resident = 0.0;
  file >> all >> resident;
  return resident * static_cast<double>(sysconf(_SC_PAGESIZE));
}

std::shared_ptr<const Volume> throughAFile(const openvdb::GridBase::Ptr& grid) {
  const test::TemporaryFolder folder;
  const std::filesystem::path file = folder / "a.vdb";
  openvdb::io::File(file.string()).write({grid});
  return loadVolume(file, "");
}

std::shared_ptr<const Volume> makeBall(double radius) {
  openvdb::initialize();
  const auto grid = openvdb::tools::createLevelSetSphere<openvdb::FloatGrid>(
      static_cast<float>(radius / kVoxel), openvdb::Vec3f(0.0F), 1.0F, 3.0F);
  grid->setName("ball");
  return throughAFile(grid);
}

std::shared_ptr<const Volume> makeCloud() {
  openvdb::initialize();
  const auto grid = openvdb::FloatGrid::create();
  grid->setName("cloud");
  grid->setGridClass(openvdb::GRID_FOG_VOLUME);
  const int n = static_cast<int>(std::lround(kRadius / kVoxel));
  for (auto at = openvdb::CoordBBox(openvdb::Coord(-n), openvdb::Coord(n)).begin(); at; ++at) {
    const double share = 1.0 - (*at).asVec3d().length() / n;
    if (share > 0.0) grid->tree().setValue(*at, static_cast<float>(share));
  }
  return throughAFile(grid);
}

PlaceSpec placeAt(const Vec3& at) {
  PlaceSpec place;
  place.kind = PlaceSpec::Kind::kMap;
  place.scale = kVoxel;
  place.translate = at;
  return place;
}

ModeSpec skin() {
  ModeSpec mode;
  mode.kind = ModeKind::kIsosurface;
  mode.of = "volume";
  mode.solid = Solid::kBelow;
  mode.strength = 3.0;
  return mode;
}
ModeSpec layers() {
  ModeSpec mode;
  mode.of = "volume";
  mode.solid = Solid::kAbove;
  mode.strength = 0.1;
  return mode;
}

SceneSpec sceneOf(const std::shared_ptr<const Volume>& volume, const ModeSpec& mode,
                  const std::vector<Vec3>& places) {
  SceneSpec spec;
  spec.source = "bench";
  VolumeSpec& many = spec.volumes[mode.of];
  many.volume = volume;
  many.instances.reserve(places.size());
  for (const Vec3& at : places) many.instances.push_back(placeAt(at));
  spec.graph.modes.push_back(mode);
  return spec;
}

/// Makes the same scene with all volumes in one graph. Each tick evaluates the whole graph.
SceneSpec oneGraphOf(const std::shared_ptr<const Volume>& volume, const ModeSpec& mode,
                     const std::vector<Vec3>& places) {
  SceneSpec spec;
  spec.source = "bench";
  for (std::size_t i = 0; i < places.size(); ++i) {
    const std::string name = "volume" + std::to_string(1000 + i);
    spec.volumes[name].volume = volume;
    spec.volumes[name].place = placeAt(places[i]);
    spec.graph.modes.push_back(mode);
    spec.graph.modes.back().of = name;
  }
  return spec;
}

/// Returns the place of a hand in free space at a time [s], on a path at 0.3 m/s.
Vec3 freePlace(double time) {
  // A circle about the two balls, in the plane through an edge's middle and a corner of the room.
  constexpr double kRound = 0.35;  // [m]
  const double turn = 0.3 * time / kRound;
  const Vec3 u = Vec3(1, 1, 0).normalized();
  const Vec3 v = Vec3(-1, 1, 1).normalized();
  return kRound * (std::cos(turn) * u + std::sin(turn) * v);
}

/// Returns the places of two balls that overlap (if `count` is 1, of one ball), and of balls out of
/// reach of the hand's paths.
std::vector<Vec3> placesOf(std::size_t count) {
  std::mt19937_64 random(1);
  // Beyond 10,000 volumes the room grows, so that the density of volumes stays the same.
  const double room = kRoom * std::cbrt(std::max(1.0, 1e-4 * static_cast<double>(count)));
  std::uniform_real_distribution<double> uniform(-room, room);
  constexpr double kApart = 0.06;  // [m] from the middle, because the hand stays within 35 mm of it
  // [m] from the free path. A ball has a radius of 2 cm, and its data reach 3 mm farther.
  constexpr double kFree = 0.03;
  std::vector<Vec3> free;
  free.reserve(2000);
  for (int i = 0; i < 2000; ++i) free.push_back(freePlace(i * (2.0 * M_PI * 0.35 / 0.3 / 2000)));
  std::vector<Vec3> places{{-0.008, 0, 0}, {0.008, 0, 0}};
  places.resize(std::min<std::size_t>(count, 2));
  while (places.size() < count) {
    const Vec3 at(uniform(random), uniform(random), uniform(random));
    const bool in_the_way = std::any_of(free.begin(), free.end(), [&](const Vec3& p) {
      return (p - at).squaredNorm() < kFree * kFree;
    });
    if (at.norm() > kApart && !in_the_way) places.push_back(at);
  }
  return places;
}

/// Returns a path around two overlapping balls, within 3 mm of their surface, at up to 0.17 m/s.
std::vector<Vec3> wayAround(std::size_t ticks) {
  std::vector<Vec3> way;
  way.reserve(ticks);
  for (std::size_t i = 0; i < ticks; ++i) {
    const double t = kDt * static_cast<double>(i);
    const Vec3 d = Vec3(std::sin(2.3 * t), std::cos(1.7 * t), std::sin(1.1 * t + 1.0)).normalized();
    double far = 0.0;
    for (const double x : {-0.008, 0.008}) {
      const double along = x * d.x();
      far = std::max(far, along + std::sqrt(kRadius * kRadius - x * x + along * along));
    }
    way.emplace_back(d * (far - 3e-3 * std::sin(6.0 * t)));
  }
  return way;
}

struct Ride {
  std::vector<double> ns;
  std::vector<StepReport> reports;
};

Ride ride(const Scene& scene, const std::vector<Vec3>& way) {
  const bench::Pinned pinned;
  Reader reader;
  ProxyState state(ForceLimits{1000.0, 1e9});
  Ride out;
  out.ns.reserve(way.size());
  out.reports.reserve(way.size());
  for (std::size_t i = 0; i < std::min<std::size_t>(1000, way.size()); ++i) {
    (void)hapticStep(scene, reader, {way[i]}, state, kDt);
  }
  state.release();
  for (const Vec3& hand : way) {
    const auto start = Clock::now();
    const StepReport report = hapticStep(scene, reader, {hand}, state, kDt);
    const auto end = Clock::now();
    out.ns.push_back(std::chrono::duration<double, std::nano>(end - start).count());
    out.reports.push_back(report);
  }
  return out;
}

ordered_json timesOf(std::vector<double> ns) {
  std::sort(ns.begin(), ns.end());
  return {{"p50_ns", rounded(bench::percentileOfSorted(ns, 0.5))},
          {"p99_ns", rounded(bench::percentileOfSorted(ns, 0.99))},
          {"p999_ns", rounded(bench::percentileOfSorted(ns, 0.999))}};
}

ordered_json spreadOf(std::vector<double> ratios) {
  std::sort(ratios.begin(), ratios.end());
  return {{"median", rounded(bench::percentileOfSorted(ratios, 0.5))},
          {"least", rounded(ratios.front())},
          {"most", rounded(ratios.back())}};
}

void append(std::vector<double>& to, const std::vector<double>& from) {
  to.insert(to.end(), from.begin(), from.end());
}

double clockCost() {
  std::vector<double> ns;
  ns.reserve(10001);
  for (int i = 0; i < 10001; ++i) {
    const auto start = Clock::now();
    ns.push_back(std::chrono::duration<double, std::nano>(Clock::now() - start).count());
  }
  return bench::percentile(ns, 0.5);
}

/// Times the search for near volumes, and whole ticks, of a hand in free space at 0.3 m/s.
void freeSpace(const Scene& scene, ordered_json& row) {
  constexpr int kLooks = 40000;
  std::vector<Vec3> way;
  way.reserve(kLooks);
  for (int i = 0; i < kLooks; ++i) way.push_back(freePlace(kDt * i));
  {
    const bench::Pinned pinned;
    NearBoxes near;
    std::vector<double> all;
    std::vector<double> asking;
    all.reserve(kLooks);
    asking.reserve(kLooks);
    std::size_t found = 0;
    for (const Vec3& p : way) {
      const auto start = Clock::now();
      found += near.near(scene.bounds, {p, p}).size();
      const auto end = Clock::now();
      all.push_back(std::chrono::duration<double, std::nano>(end - start).count());
      if (near.asked()) asking.push_back(all.back());
    }
    row["look_up"] = timesOf(std::move(all));
    row["look_up"]["asking_p50_ns"] = rounded(bench::percentile(asking, 0.5));
    row["look_up"]["asking_share"] = rounded(static_cast<double>(asking.size()) / kLooks);
    row["look_up"]["near"] = rounded(static_cast<double>(found) / kLooks);
  }
  const Ride free = ride(scene, way);
  for (const StepReport& r : free.reports) {
    if (r.wanted != Vec3::Zero()) throw std::runtime_error("a force acts in free space");
  }
  row["free_tick"] = timesOf(free.ns);
}

/// Returns the memory of the readers and proxies of four hands after their first ticks [bytes].
double memoryOfHands(const Scene& scene, const std::vector<Vec3>& way) {
  const double before = residentMemory();
  std::vector<Reader> readers(4);
  std::vector<ProxyState> states(4);
  for (std::size_t hand = 0; hand < readers.size(); ++hand) {
    for (std::size_t i = 0; i < std::min<std::size_t>(2000, way.size()); ++i) {
      (void)hapticStep(scene, readers[hand], {way[i]}, states[hand], kDt);
    }
  }
  return residentMemory() - before;
}

ordered_json byNumber(const Options& options, const std::shared_ptr<const Volume>& ball) {
  ordered_json rows = ordered_json::array();
  const std::vector<Vec3> way = wayAround(options.quick ? 4000 : 40000);
  const BuiltScene two = buildScene(sceneOf(ball, skin(), placesOf(2)));
  for (const std::size_t count : {1, 2, 5, 10, 30, 100, 300, 1000, 3000, 10000, 100000, 1000000}) {
    bench::tell("placements: " + std::to_string(count));
    const SceneSpec spec = sceneOf(ball, skin(), placesOf(count));
    const double before = residentMemory();
    const auto start = Clock::now();
    const BuiltScene built = buildScene(spec);
    const double build = seconds(start);
    ordered_json row{{"placements", count},
                     {"build_s", rounded(build)},
                     {"memory_mb", rounded(1e-6 * (residentMemory() - before))},
                     {"hands_mb", rounded(1e-6 * memoryOfHands(*built.scene, way))}};
    std::vector<double> alone_ns;
    std::vector<double> all_ns;
    std::vector<double> medians;
    std::vector<double> tails;
    for (int pair = 0; pair < options.pairs; ++pair) {
      Ride alone;
      Ride all;
      if (pair % 2 == 0) alone = ride(*two.scene, way);
      all = ride(*built.scene, way);
      if (pair % 2 == 1) alone = ride(*two.scene, way);
      medians.push_back(bench::percentile(all.ns, 0.5) / bench::percentile(alone.ns, 0.5));
      tails.push_back(bench::percentile(all.ns, 0.999) / bench::percentile(alone.ns, 0.999));
      append(alone_ns, alone.ns);
      append(all_ns, all.ns);
      // Throws if the forces differ, because the comparison would then be useless.
      for (std::size_t i = 0; i < way.size() && count >= 2; ++i) {
        if ((all.reports[i].wanted - alone.reports[i].wanted).norm() > 1e-9) {
          throw std::runtime_error("other volumes act on the hand too: the comparison is useless");
        }
      }
    }
    row["tick"] = timesOf(std::move(all_ns));
    if (count >= 2) {
      row["two_alone"] = timesOf(std::move(alone_ns));
      row["p50_ratio"] = spreadOf(std::move(medians));
      row["p999_ratio"] = spreadOf(std::move(tails));
    }
    freeSpace(*built.scene, row);
    rows.push_back(row);
  }
  return rows;
}

/// Several clouds, with centres within 4 mm of the origin along each axis, and a hand's path
/// through them.
struct Heap {
  std::vector<Vec3> places;
  std::vector<Vec3> way;

  Heap(std::size_t count, std::size_t ticks) {
    std::mt19937_64 random(2);
    std::uniform_real_distribution<double> uniform(-4e-3, 4e-3);
    while (places.size() < count) {
      places.emplace_back(uniform(random), uniform(random), uniform(random));
    }
    way.reserve(ticks);
    for (std::size_t i = 0; i < ticks; ++i) {
      const double t = kDt * static_cast<double>(i);
      way.emplace_back(0.008 * Vec3(std::sin(1.3 * t), std::cos(1.1 * t), std::sin(0.9 * t)));
    }
  }
};

/// Measures ticks with different numbers of clouds, up to more clouds than a tick can evaluate.
ordered_json crowds(const Options& options) {
  ordered_json rows = ordered_json::array();
  const auto cloud = makeCloud();
  for (const std::size_t count : {64, 65, 128, 512, 1024, 2048}) {
    bench::tell("crowd: " + std::to_string(count));
    const Heap heap(count, options.quick ? 1000 : 10000);
    const BuiltScene built = buildScene(sceneOf(cloud, layers(), heap.places));
    const Ride ridden = ride(*built.scene, heap.way);
    double missing = 0.0;
    for (const StepReport& r : ridden.reports) missing = std::max(missing, r.missing);
    rows.push_back(
        {{"placed", count}, {"tick", timesOf(ridden.ns)}, {"missing_n", rounded(missing)}});
  }
  return rows;
}

ordered_json byOverlap(const Options& options) {
  ordered_json rows = ordered_json::array();
  const auto cloud = makeCloud();
  for (const std::size_t count : {1, 2, 4, 8, 12, 16, 24, 32, 48, 64}) {
    bench::tell("overlapping: " + std::to_string(count));
    const Heap heap(count, options.quick ? 2000 : 10000);
    const BuiltScene parts = buildScene(sceneOf(cloud, layers(), heap.places));
    const BuiltScene one = buildScene(oneGraphOf(cloud, layers(), heap.places));
    std::vector<double> parts_ns;
    std::vector<double> one_ns;
    std::vector<double> ratios;
    double iterations = 0.0;
    double differs = 0.0;
    const auto keep = [&](const Ride& ridden, std::vector<double>& ns) {
      std::vector<double> own;
      own.reserve(heap.way.size());
      for (std::size_t i = 0; i < heap.way.size(); ++i) {
        if (static_cast<std::size_t>(ridden.reports[i].primitives) != count) continue;
        own.push_back(ridden.ns[i]);
      }
      append(ns, own);
      return bench::percentile(own, 0.5);
    };
    for (int pair = 0; pair < options.pairs; ++pair) {
      Ride together;
      if (pair % 2 == 0) together = ride(*one.scene, heap.way);
      const Ride apart = ride(*parts.scene, heap.way);
      if (pair % 2 == 1) together = ride(*one.scene, heap.way);
      ratios.push_back(keep(apart, parts_ns) / keep(together, one_ns));
      for (std::size_t i = 0; i < heap.way.size(); ++i) {
        iterations += apart.reports[i].iterations;
        // A surface mode keeps the value at which its contact began. The scenes may read at other
        // ticks, so this value, and with it the force, may differ.
        differs = std::max(differs, (apart.reports[i].wanted - together.reports[i].wanted).norm());
      }
    }
    // Compares with the reference balance of the primitives that the tick has placed.
    const double k = parts.scene->coupling.stiffness;
    Reader reader;
    ProxyState state(ForceLimits{1000.0, 1e9});
    double off = 0.0;
    double bound = 0.0;
    double felt = 0.0;
    int compared = 0;
    for (std::size_t i = 0; i < heap.way.size(); ++i) {
      const StepReport r = hapticStep(*parts.scene, reader, {heap.way[i]}, state, kDt);
      if (i % 20 != 0 || static_cast<std::size_t>(r.primitives) != count ||
          r.status != StepStatus::kConverged) {
        continue;
      }
      const test::Reference exact =
          test::solveReference(heap.way[i], k, state.primitives().items());
      const double error = k * (state.proxy() - heap.way[i] - exact.offset).norm();
      const double allowed = k * (r.error_bound + exact.error_bound);
      // The bound is that of the balance. A tick may answer with the target of Newton's step, which
      // differs from the balance at the last reading within the tolerance.
      off = std::max(off, error);
      bound = std::max(bound, allowed);
      felt = std::max(felt, k * exact.offset.norm());
      ++compared;
    }
    const double ridden = static_cast<double>(options.pairs) * static_cast<double>(heap.way.size());
    rows.push_back({{"overlap", count},
                    {"tick", timesOf(parts_ns)},
                    {"one_graph", timesOf(one_ns)},
                    {"ratio", spreadOf(std::move(ratios))},
                    {"kept", rounded(static_cast<double>(parts_ns.size()) / ridden)},
                    {"iterations", rounded(iterations / ridden)},
                    {"compared", compared},
                    {"force_n", rounded(felt)},
                    {"error_n", rounded(off)},
                    {"bound_n", rounded(bound)},
                    {"differs_n", rounded(differs)}});
  }
  return rows;
}

ordered_json bySize(const Options& options) {
  ordered_json rows = ordered_json::array();
  const std::vector<double> radii =
      options.quick ? std::vector<double>{0.02, 0.1}
                    : std::vector<double>{0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.5};
  for (const double radius : radii) {
    bench::tell("radius: " + std::to_string(radius));
    const double empty = residentMemory();
    const auto volume = makeBall(radius);
    const auto start = Clock::now();
    const BuiltScene single = buildScene(sceneOf(volume, skin(), {Vec3::Zero()}));
    const double first = seconds(start);
    const double with_one = residentMemory();
    std::vector<Vec3> places;
    places.reserve(1000);
    for (int i = 0; i < 1000; ++i) {
      const int layer = i / 100;
      places.emplace_back(Vec3(i % 10, i / 10 % 10, layer) * 2.2 * radius);
    }
    const auto again = Clock::now();
    const BuiltScene many = buildScene(sceneOf(volume, skin(), places));
    const double thousand = seconds(again);
    const double with_all = residentMemory();
    std::vector<Vec3> way;
    const std::size_t ticks = options.quick ? 4000 : 40000;
    way.reserve(ticks);
    for (std::size_t i = 0; i < ticks; ++i) {
      const double t = kDt * static_cast<double>(i);
      const double turn = 0.1 * t / radius;  // 0.1 m/s
      way.emplace_back(
          (radius - 1e-3 * std::sin(6.0 * t)) *
          Vec3(std::sin(turn), std::cos(turn), 0.3 * std::sin(0.37 * turn)).normalized());
    }
    std::vector<double> ns;
    for (int run = 0; run < options.pairs; ++run) append(ns, ride(*many.scene, way).ns);
    rows.push_back({{"volume_mb", rounded(1e-6 * static_cast<double>(volume->memory()))},
                    {"tick", timesOf(std::move(ns))},
                    {"one_mb", rounded(1e-6 * (with_one - empty))},
                    {"thousand_mb", rounded(1e-6 * (with_all - empty))},
                    {"build_one_s", rounded(first)},
                    {"build_thousand_s", rounded(thousand)}});
  }
  return rows;
}

/// Measures a scene from a file. The simulated hand explores the scene's bounds (explore()).
ordered_json explored(const Options& options, const std::string& file) {
  bench::tell(file);
  const double before = residentMemory();
  const auto start = Clock::now();
  const SceneSpec spec = openScene(file);
  const BuiltScene built = buildScene(spec);
  const double build = seconds(start);
  const double memory = residentMemory() - before;
  SimulatedDevice device({}, {}, explore(built.bounds, options.quick ? 5.0 : 60.0), 1000.0);
  Reader reader;
  ProxyState state(device.info().limits);
  std::vector<double> ns;
  int most = 0;
  double parts = 0.0;
  long left_out = 0;
  while (!device.ended()) {
    const HandState hand = device.read();
    const auto begin = Clock::now();
    const StepReport report = hapticStep(*built.scene, reader, hand, state, kDt);
    ns.push_back(std::chrono::duration<double, std::nano>(Clock::now() - begin).count());
    device.write(report.force);
    most = std::max(most, report.parts);
    parts += report.parts;
    left_out += report.left_out > 0 ? 1 : 0;
  }
  ordered_json json{{"scene", std::filesystem::path(file).filename().string()},
                    {"parts", built.scene->parts.size()},
                    {"volumes", built.volumes.size()},
                    {"ticks", ns.size()},
                    {"felt_mean", rounded(parts / static_cast<double>(ns.size()))},
                    {"felt_most", most},
                    {"ticks_with_parts_left_out", left_out}};
  json["tick"] = timesOf(std::move(ns));
  json["build_s"] = rounded(build);
  json["memory_mb"] = rounded(1e-6 * memory);
  return json;
}

int run(const Options& options) {
  ordered_json json;
  const auto ball = makeBall(kRadius);
  {
    // Builds a scene before measuring, because the first build allocates additional memory.
    (void)buildScene(sceneOf(ball, skin(), placesOf(10)));
  }
  bench::Machine machine = bench::takeMachine(false);
  machine.pinned = bench::Pinned().good();
  json["machine"] = bench::asJson(machine);
  json["clock_ns"] = rounded(clockCost());
  const auto wanted = [&](const char* what) {
    return options.only.empty() || options.only == what;
  };
  if (wanted("number")) json["number"] = byNumber(options, ball);
  if (wanted("overlap")) json["overlap"] = byOverlap(options);
  if (wanted("crowd")) json["crowd"] = crowds(options);
  if (wanted("size")) json["size"] = bySize(options);
  json["scenes"] = ordered_json::array();
  for (const std::string& scene : options.scenes)
    json["scenes"].push_back(explored(options, scene));
  bench::tell("");
  bench::writeResult(json, options.out);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  Options options;
  CLI::App app("What many volumes cost: ticks, memory, building");
  app.add_flag("--quick", options.quick, "Fewer ticks, small volumes");
  app.add_option("--pairs", options.pairs, "Pairs of runs")->check(CLI::Range(1, 1000));
  app.add_option("--only", options.only, "One of the tables")
      ->check(CLI::IsMember({"number", "overlap", "crowd", "size"}));
  app.add_option("--scene", options.scenes, "A scene to explore as well");
  app.add_option("--out", options.out, "Where the result goes, as JSON");
  CLI11_PARSE(app, argc, argv);
  try {
    return run(options);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_scale: %s\n", e.what());
    return 2;
  }
}
