/// Measures the calls of a script in C++, for comparison by script_cost.py. Samples the same points
/// of the same grid, and runs the same ticks of the same scene.
///
///     palpate_bench_script FILE.vdb GRID POINTS PROBES
///
/// POINTS (in the file's space) and PROBES (in world space) are files of raw doubles, three per
/// point. Prints the smallest of five rounds, in this order: ns per sample, ns per tick.
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <exception>
#include <fstream>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>

#include "palpate/devices/simulated/path_device.h"
#include "palpate/engine/tick/step.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/scenes/library/scene_file.h"

namespace {

using namespace palpate;

struct Row {
  bool inside;
  double value;
  std::array<double, 3> gradient;
};

std::vector<Vec3> readPoints(const char* file) {
  std::ifstream in(file, std::ios::binary);
  std::vector<Vec3> points;
  std::array<double, 3> p{};
  while (in.read(reinterpret_cast<char*>(p.data()), sizeof(p))) {
    points.emplace_back(p[0], p[1], p[2]);
  }
  if (points.empty())
    throw std::runtime_error(std::string(file) + " has no points, or cannot be read");
  return points;
}

template <class Round>
double best(std::size_t items, Round round) {
  double least = 1e300;
  for (int i = 0; i < 5; ++i) {
    const auto begin = std::chrono::steady_clock::now();
    round();
    const std::chrono::duration<double, std::nano> took = std::chrono::steady_clock::now() - begin;
    least = std::min(least, took.count() / static_cast<double>(items));
  }
  return least;
}

}  // namespace

int main(int argc, char** argv) try {
  if (argc != 5) throw std::runtime_error("give FILE.vdb GRID POINTS PROBES");
  const std::vector<Vec3> points = readPoints(argv[3]);
  const FieldPtr field = makeVdbField(loadVolume(argv[1], argv[2]), Placement{});
  const ScalarField& scalar = *std::get<0>(field);
  const double sample = best(points.size(), [&] {
    // Allocates new memory in every round, as each call of a script does.
    std::vector<Row> rows(points.size());
    FieldCache cache;
    scalar.reset(cache);
    for (std::size_t i = 0; i < points.size(); ++i) {
      const ScalarSample s = scalar.sample(points[i], cache);
      rows[i] = {s.inside, s.value, {s.gradient.x(), s.gradient.y(), s.gradient.z()}};
    }
  });

  const std::vector<Vec3> probes = readPoints(argv[4]);
  const BuiltScene built = buildScene(openScene(argv[1]));
  double sum = 0.0;
  const double tick = best(probes.size(), [&] {
    Reader reader;
    ProxyState state(PathDevice({PathPoint{}}, 1000.0).info().limits);
    for (const Vec3& p : probes) {
      sum += hapticStep(*built.scene, reader, {p}, state, 1e-3).force.z();
    }
  });
  std::printf("%.1f %.1f\n", sample, tick);
  return sum > 1e300 ? 1 : 0;
} catch (const std::exception& e) {
  std::fprintf(stderr, "palpate_bench_script: %s\n", e.what());
  return 2;
}
