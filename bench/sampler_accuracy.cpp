/// Measures time per call, and errors of value and gradient, with warm, cold and emptied caches.
/// Covers every interpolation of palpate, OpenVDB's samplers and its box stencil, and NanoVDB's
/// trilinear sampler if its headers were found.
///
///     palpate_bench_sampler_accuracy > sampler_accuracy.json
///     bench/sampler_accuracy_chart.py sampler_accuracy.json docs/charts
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <fstream>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

#include "bench/machine.h"
#include "bench/report.h"
#include "bench/sampler_contenders.h"
#include "tests/support/percentiles.h"
#include "tests/support/random.h"

namespace {

using namespace palpate;
using namespace palpate::bench;
using nlohmann::ordered_json;

struct Options {
  bool quick = false;
  std::string output;

  [[nodiscard]] std::size_t errorPoints() const { return quick ? 20000 : 200000; }
  [[nodiscard]] std::size_t jumpPoints() const { return quick ? 2000 : 20000; }
  [[nodiscard]] double ballRadius() const { return quick ? 40.0 : 200.0; }  // [voxels]
  [[nodiscard]] std::size_t walkSteps() const { return quick ? 2000 : 20000; }
  [[nodiscard]] std::size_t coldPoints() const { return quick ? 2000 : 100000; }
  [[nodiscard]] std::size_t rounds() const { return quick ? 3 : 31; }
  [[nodiscard]] std::size_t firstCalls() const { return quick ? 3 : 300; }
};

/// A field with a known gradient. Values are at most 1, gradients per voxel at most `steepest`.
struct Analytic {
  const char* name;
  double voxels;  ///< Voxels per wavelength, or per radius of the ball.
  double steepest;
  int block;  ///< Edge of the block that holds the field [voxels].
  std::function<Sampled(const Vec3&)> truth;
  std::function<Vec3(test::Random&)> place;
};

/// Voxels around the measured region. In a cubic spline, a voxel's effect falls to 27 % per voxel.
constexpr double kMargin = 16.0;
/// Offset of the waves, so that voxels are not at zeros or maxima of the field.
const Vec3 kOff(0.37, 0.21, 0.44);

Analytic makeWaves(double voxels) {
  const double k = 2.0 * M_PI / voxels;
  const double edge = std::max(voxels, 16.0);
  return {"waves",
          voxels,
          k,
          static_cast<int>(edge + 2.0 * kMargin) + 1,
          [k](const Vec3& p) -> Sampled {
            const Eigen::Array3d s = (k * (p + kOff)).array().sin();
            const Eigen::Array3d c = (k * (p + kOff)).array().cos();
            return {s.prod(), k * Vec3(c[0] * s[1] * s[2], s[0] * c[1] * s[2], s[0] * s[1] * c[2])};
          },
          [edge](test::Random& random) -> Vec3 {
            return Vec3::Constant(kMargin + 0.5 * edge) + random.inCube(0.5 * edge);
          }};
}

/// Makes the distance to a ball's surface divided by the radius, up to a quarter of the radius.
Analytic makeDistance(double voxels) {
  const int block = static_cast<int>(2.5 * voxels + 2.0 * kMargin) + 2;
  const Vec3 centre = Vec3::Constant(0.5 * block) + kOff;
  return {"distance",
          voxels,
          1.0 / voxels,
          block,
          [=](const Vec3& p) -> Sampled {
            const double r = (p - centre).norm();
            return {r / voxels - 1.0, (p - centre) / (r * voxels)};
          },
          [=](test::Random& random) -> Vec3 {
            return centre + voxels * random.uniform(0.75, 1.25) * random.direction();
          }};
}

struct Error {
  double squares = 0.0;
  double largest = 0.0;
  std::size_t count = 0;

  void add(double error) {
    squares += error * error;
    largest = std::max(largest, error);
    ++count;
  }
  [[nodiscard]] ordered_json json() const {
    return {
        {"rms", rounded(std::sqrt(squares / static_cast<double>(std::max<std::size_t>(1, count))))},
        {"max", rounded(largest)}};
  }
};

double degreesBetween(const Vec3& a, const Vec3& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * 180.0 / M_PI;
}

/// Returns the gradient's largest jump across faces of cells and voxels, divided by `steepest`.
double largestJump(Sampler& sampler, const Analytic& field, std::size_t count) {
  constexpr double kBeside = 1e-6;
  test::Random random(2);
  double largest = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    Vec3 p = field.place(random);
    const auto axis = static_cast<Eigen::Index>(i % 3);
    p[axis] = 0.5 * std::round(2.0 * p[axis]);
    const Vec3 step = kBeside * Vec3::Unit(axis);
    largest =
        std::max(largest, (sampler.at(p + step).gradient - sampler.at(p - step).gradient).norm());
  }
  return largest / field.steepest;
}

ordered_json judge(const Contender& contender, const Analytic& field, const Options& options) {
  Error value;
  Error gradient;
  Error direction;
  test::Random random(1);
  for (std::size_t i = 0; i < options.errorPoints(); ++i) {
    const Vec3 p = field.place(random);
    const Sampled truth = field.truth(p);
    const Sampled found = contender.sampler->at(p);
    value.add(std::abs(found.value - truth.value));
    gradient.add((found.gradient - truth.gradient).norm() / field.steepest);
    if (truth.gradient.norm() < 0.1 * field.steepest) continue;
    direction.add(degreesBetween(found.gradient, truth.gradient));
  }
  ordered_json out = {{"field", field.name},
                      {"voxels", field.voxels},
                      {"method", contender.method},
                      {"points", value.count},
                      {"value", value.json()}};
  if (contender.reads == Reads::kValueAndGradient) {
    out["gradient"] = gradient.json();
    out["direction_deg"] = direction.json();
    out["jump"] = rounded(largestJump(*contender.sampler, field, options.jumpPoints()));
  }
  return out;
}

ordered_json measureErrors(const Options& options) {
  ordered_json results = ordered_json::array();
  for (const auto& make : {makeWaves, makeDistance}) {
    for (const double voxels : {4.0, 8.0, 16.0, 32.0}) {
      const Analytic field = make(voxels);
      tell(std::string("errors: ") + field.name + ", " + std::to_string(static_cast<int>(voxels)));
      const Contest contest =
          overBlock(field.block, [&](const Vec3& p) { return field.truth(p).value; });
      for (const Contender& c : contest.contenders) results.push_back(judge(c, field, options));
    }
  }
  return results;
}

/// The ball of the walk. Its band lies within one of the tree's largest nodes, of 4096^3 voxels.
struct Ball {
  Vec3 centre = Vec3::Constant(2048.3);
  double radius = 0.0;
  static constexpr double kBand = 1.5;  ///< Half-width of the band [voxels].

  [[nodiscard]] Vec3 anywhere(test::Random& random) const {
    return centre + random.uniform(radius - kBand, radius + kBand) * random.direction();
  }
};

/// Makes a path through the band, in steps of up to 0.1 voxel with slowly changing direction.
std::vector<Vec3> makeWalk(const Ball& ball, std::size_t steps) {
  constexpr double kStep = 0.1;
  test::Random random(3);
  Vec3 offset = ball.radius * Vec3(0.61, 0.5, 0.33).normalized();
  Vec3 heading = random.direction();
  std::vector<Vec3> walk;
  for (std::size_t i = 0; i < steps; ++i) {
    heading = (heading + 0.3 * random.direction()).normalized();
    offset += heading * random.uniform(0.0, kStep);
    const double away = offset.norm() - ball.radius;
    if (std::abs(away) > Ball::kBand) {  // turns back at the band's edge
      const Vec3 normal = offset.normalized();
      heading -= 2.0 * heading.dot(normal) * normal;
      offset = normal * (ball.radius + std::copysign(Ball::kBand, away));
    }
    walk.push_back(ball.centre + offset);
  }
  return walk;
}

std::vector<Vec3> makeScatter(const Ball& ball, std::size_t count) {
  test::Random random(4);
  std::vector<Vec3> points;
  for (std::size_t i = 0; i < count; ++i) points.push_back(ball.anywhere(random));
  return points;
}

/// Returns the size of core 0's last-level cache [bytes]; 32 MiB if unknown. sysconf would add
/// those of all cores.
std::size_t lastCache() {
  std::ifstream file("/sys/devices/system/cpu/cpu0/cache/index3/size");
  std::size_t kilobytes = 0;
  return file >> kilobytes ? kilobytes << 10U : std::size_t{32} << 20U;
}

/// Memory of twice the size of the last-level cache, or of 1 MiB if `quick`. Reading the large one
/// evicts all other data.
class Evictor {
 public:
  explicit Evictor(bool quick) : memory_((quick ? 1U << 20U : 2 * lastCache()) / sizeof(long), 1) {}

  void run() {
    constexpr std::size_t kLine = 64 / sizeof(long);
    for (std::size_t i = 0; i < memory_.size(); i += kLine) sum_ = sum_ + memory_[i];
  }
  [[nodiscard]] std::size_t bytes() const { return memory_.size() * sizeof(long); }

 private:
  std::vector<long> memory_;
  volatile long sum_ = 0;
};

/// Times of one contender [ns]: the mean per call in each round, and single first calls.
struct Cost {
  std::vector<double> walk;
  std::vector<double> cold;
  std::vector<double> first_near;
  std::vector<double> first_far;
};

ordered_json ofRounds(const std::vector<double>& ns) {
  return {{"median", rounded(percentile(ns, 0.5))},
          {"p10", rounded(percentile(ns, 0.1))},
          {"p90", rounded(percentile(ns, 0.9))}};
}

ordered_json ofCalls(const std::vector<double>& ns) {
  return {{"p50", rounded(percentile(ns, 0.5))},
          {"p90", rounded(percentile(ns, 0.9))},
          {"p99", rounded(percentile(ns, 0.99))},
          {"count", ns.size()}};
}

/// Returns the time per call [ns], from the middle half of small batches, to exclude other work.
double timeCalls(Sampler& sampler, std::span<const Vec3> points) {
  return middleOfBatches(points,
                         [&](std::span<const Vec3> batch) { return sampler.timeAll(batch); });
}

/// Calls `turn` for every contender in every round. Each round begins with the next contender, so
/// that other work of the machine affects all equally.
template <class Turn>
void takeTurns(std::size_t contenders, std::size_t rounds, const char* what, Turn turn) {
  for (std::size_t round = 0; round < rounds; ++round) {
    tell(std::string(what) + ", round " + std::to_string(round + 1));
    for (std::size_t i = 0; i < contenders; ++i) turn((i + round) % contenders, round);
  }
}

std::vector<Cost> measureCosts(const Contest& contest, const Ball& ball, const Options& options,
                               Evictor& evictor) {
  const std::vector<Vec3> walk = makeWalk(ball, options.walkSteps());
  const std::vector<Vec3> scatter = makeScatter(ball, options.coldPoints());
  const std::size_t count = contest.contenders.size();
  std::vector<Cost> costs(count);
  const auto sampler = [&](std::size_t i) -> Sampler& { return *contest.contenders[i].sampler; };

  takeTurns(count, options.rounds(), "walk and random points", [&](std::size_t i, std::size_t) {
    // Runs the same steps once without timing, to load their data into the caches.
    static_cast<void>(sampler(i).timeAll(walk));
    costs[i].walk.push_back(timeCalls(sampler(i), walk));
    costs[i].cold.push_back(timeCalls(sampler(i), scatter));
  });
  takeTurns(count, options.firstCalls(), "first calls", [&](std::size_t i, std::size_t round) {
    // The next call is either one step further along the path, or anywhere in the ball's band.
    const auto after = [&](const Vec3& before, const Vec3& now) {
      static_cast<void>(sampler(i).at(before));
      evictor.run();
      return sampler(i).timeOne(now);
    };
    const std::size_t step = (round * 61) % (walk.size() - 1);
    const std::size_t place = (2 * round) % (scatter.size() - 1);
    costs[i].first_near.push_back(after(walk[step], walk[step + 1]));
    costs[i].first_far.push_back(after(scatter[place], scatter[place + 1]));
  });
  return costs;
}

ordered_json describe(const Contest& contest, const std::vector<Cost>& costs) {
  ordered_json methods = ordered_json::array();
  for (std::size_t i = 0; i < costs.size(); ++i) {
    const Contender& contender = contest.contenders[i];
    methods.push_back({{"method", contender.method},
                       {"reads", wordFor(contender.reads)},
                       {"note", contender.note},
                       {"walk_ns", ofRounds(costs[i].walk)},
                       {"cold_ns", ofRounds(costs[i].cold)},
                       {"first_near_ns", ofCalls(costs[i].first_near)},
                       {"first_far_ns", ofCalls(costs[i].first_far)}});
  }
  return methods;
}

ordered_json sizeOf(const Contest& contest) {
  return {{"active_voxels", contest.active_voxels}, {"memory", contest.memory}};
}

int run(const Options& options) {
  const ordered_json errors = measureErrors(options);

  // Builds before the thread is pinned, because loading and the B-splines' filter use all cores.
  Ball ball;
  ball.radius = options.ballRadius();
  tell("the ball");
  Contest scalar = overBall(ball.centre, ball.radius);
  scalar.contenders.push_back(makeNothing());
  const Contest vector = overSpinningBall(ball.centre, ball.radius);
  const Machine machine = takeMachine();
  Evictor evictor(options.quick);
  const std::vector<Cost> scalar_costs = measureCosts(scalar, ball, options, evictor);
  const std::vector<Cost> vector_costs = measureCosts(vector, ball, options, evictor);
  tell("");

  writeResult({{"machine", asJson(machine)},
               {"options",
                {{"quick", options.quick},
                 {"rounds", options.rounds()},
                 {"walk_steps", options.walkSteps()},
                 {"cold_points", options.coldPoints()},
                 {"first_calls", options.firstCalls()},
                 {"evicted_bytes", evictor.bytes()},
                 {"nanovdb", hasNanoVdb()}}},
               {"grids", {{"scalar", sizeOf(scalar)}, {"vector", sizeOf(vector)}}},
               {"errors", errors},
               {"scalar", describe(scalar, scalar_costs)},
               {"vector", describe(vector, vector_costs)}},
              options.output);
  if (!hasNanoVdb()) std::fprintf(stderr, "NanoVDB is left out: its headers were not found\n");
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    Options options;
    CLI::App app{"Time per call against error of value and gradient, sampler by sampler; JSON."};
    app.add_flag("--quick", options.quick, "few points, a small grid, no care for times");
    app.add_option("--output", options.output, "a file instead of standard output");
    CLI11_PARSE(app, argc, argv);
    return run(options);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_sampler_accuracy: %s\n", e.what());
    return 2;
  }
}
