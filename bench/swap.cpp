/// Measures whether a thread that loads, publishes and frees a large volume delays the ticks.
///
///     palpate_bench_swap [--pairs N] [--seconds S] [--rate HZ] [--voxels N]
///
/// Compares pairs of runs of the real loop, in alternating order. In one run the scene stays. In
/// the other, the volume is loaded and replaced as often as possible.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <exception>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <CLI/CLI.hpp>

#include "bench/machine.h"
#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"
#include "tests/support/percentiles.h"
#include "tests/support/vdb_files.h"

namespace {

using namespace palpate;

class Times final : public TickSink {
 public:
  explicit Times(std::size_t most) { ns_.reserve(most); }
  void take(const Telemetry& tick, const ProxyState& /*state*/) noexcept override {
    if (ns_.size() < ns_.capacity()) ns_.push_back(static_cast<double>(tick.tick_ns));
    late_ = tick.late_ticks;
  }
  [[nodiscard]] const std::vector<double>& ns() const { return ns_; }
  [[nodiscard]] long late() const { return static_cast<long>(late_); }

 private:
  std::vector<double> ns_;
  std::int64_t late_ = 0;
};

/// Writes fog with waves in which every voxel is active, so that no part is stored as a tile.
void writeVolume(const std::string& file, int n) {
  openvdb::initialize();
  auto grid = openvdb::FloatGrid::create(0.0F);
  grid->setName("density");
  grid->setGridClass(openvdb::GRID_FOG_VOLUME);
  grid->tree().denseFill(openvdb::CoordBBox(openvdb::Coord(0), openvdb::Coord(n - 1)), 1.0F);
  grid->tree().voxelizeActiveTiles();
  for (auto leaf = grid->tree().beginLeaf(); leaf; ++leaf) {
    for (auto voxel = leaf->beginValueOn(); voxel; ++voxel) {
      const openvdb::Coord at = voxel.getCoord();
      voxel.setValue(
          static_cast<float>(0.5 + 0.5 * std::sin(0.1 * at.x()) * std::sin(0.1 * at.y())));
    }
  }
  openvdb::io::File out(file);
  out.setCompression(openvdb::io::COMPRESS_NONE);
  out.write({grid});
}

std::shared_ptr<const Scene> load(const std::string& file, double& bytes) {
  const auto volume = loadVolume(file, "");
  bytes = static_cast<double>(volume->info().memory);
  Placement placement;
  placement.scale = 0.1 / volume->info().bounds.size().maxCoeff();
  placement.translate = -placement.scale * volume->info().bounds.centre();
  GraphSpec spec;
  spec.modes.resize(1);
  spec.modes[0].kind = ModeKind::kIsosurface;
  spec.modes[0].of = "fog";
  spec.modes[0].value = 0.5;
  spec.modes[0].solid = Solid::kAbove;
  spec.modes[0].strength = 3.0;
  return makeScene(spec, {{"fog", makeVdbField(volume, placement)}});
}

struct Options {
  int pairs = 10;
  double seconds = 10.0;
  double rate = 1000.0;
  int voxels = 640;
};

struct Result {
  double p50 = 0.0;
  double p999 = 0.0;
  long late = 0;
  int swaps = 0;
  std::int64_t faults = 0;
};

Result run(const std::string& file, const std::shared_ptr<const Scene>& scene,
           const Options& options, bool swap) {
  // The hand moves in and out of the waves.
  const Box bounds{Vec3::Constant(-0.05), Vec3::Constant(0.05)};
  SimulatedDevice device(ArmParams{}, GripParams{}, explore(bounds, options.seconds), options.rate);
  Times times(static_cast<std::size_t>(2.0 * options.seconds * options.rate) + 1000);
  LoopParams params;
  params.rate = options.rate;
  HapticThread hand(device, params, &times);
  hand.publish(scene);
  Result out;
  double bytes = 0.0;
  while (hand.running()) {
    if (swap) {
      hand.publish(load(file, bytes));
      ++out.swaps;
    } else {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  }
  hand.stop();
  out.p50 = bench::percentile(times.ns(), 0.5);
  out.p999 = bench::percentile(times.ns(), 0.999);
  out.late = times.late();
  out.faults = hand.pageFaultsSinceStart();
  return out;
}

int measure(const Options& options) {
  const test::TemporaryFolder folder;
  const std::string file = (folder / "fog.vdb").string();
  writeVolume(file, options.voxels);
  double bytes = 0.0;
  const auto scene = load(file, bytes);
  std::printf("%s\n", bench::describe(bench::takeMachine(false)).c_str());
  std::printf("a volume of %.2f GB, %g Hz, %g s a run\n", 1e-9 * bytes, options.rate,
              options.seconds);
  std::printf(
      "pair   still: p50 us  p99.9 us  late  faults   swapped: p50 us  p99.9 us  late  faults  "
      "swaps\n");
  std::vector<double> ratios;
  long late_still = 0;
  long late_swapped = 0;
  for (int pair = 0; pair < options.pairs; ++pair) {
    Result still;
    Result swapped;
    for (const bool swap : {pair % 2 == 0, pair % 2 != 0}) {
      (swap ? swapped : still) = run(file, scene, options, swap);
    }
    std::printf("%4d %15.2f %9.2f %5ld %7lld %17.2f %9.2f %5ld %7lld %6d\n", pair + 1,
                1e-3 * still.p50, 1e-3 * still.p999, still.late,
                static_cast<long long>(still.faults), 1e-3 * swapped.p50, 1e-3 * swapped.p999,
                swapped.late, static_cast<long long>(swapped.faults), swapped.swaps);
    std::fflush(stdout);
    ratios.push_back(swapped.p999 / still.p999);
    late_still += still.late;
    late_swapped += swapped.late;
  }
  std::printf(
      "p99.9 of the tick, swapped by still: median %.3f; late ticks %ld still, %ld swapped\n",
      bench::percentile(ratios, 0.5), late_still, late_swapped);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    Options options;
    CLI::App app{"Time of a tick while a large volume is swapped, and while it stays."};
    app.add_option("--pairs", options.pairs, "default 10");
    app.add_option("--seconds", options.seconds, "of a run, default 10");
    app.add_option("--rate", options.rate, "default 1000");
    app.add_option("--voxels", options.voxels, "along an edge; 640 is 1 GB");
    CLI11_PARSE(app, argc, argv);
    return measure(options);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_swap: %s\n", e.what());
    return 2;
  }
}
