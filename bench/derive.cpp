/// Compares two ways to get a property of a flow: from the current cell at every reading, or from a
/// grid that is computed once. Measures time per reading, memory and error.
///
///     palpate_bench_derive [--quick] > derive.md
///
/// The flow is that of Arnold, Beltrami and Childress, which is known exactly. Errors are for 8, 16
/// and 32 voxels per wavelength. Times are for 16 voxels: for a walk in steps of 0.05 voxels, and
/// for random points.
#include "palpate/samplers/grid/derive.h"

#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <exception>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>
#include <Eigen/Geometry>

#include "bench/machine.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "tests/support/percentiles.h"
#include "tests/support/probe.h"
#include "tests/support/random.h"
#include "tests/support/vdb_grids.h"

namespace {

using namespace palpate;
using bench::Clock;
using openvdb::Vec3d;

constexpr double kMegabyte = 1e6;
/// Least distance of the points from the block's edges [voxels]. At an edge, neighbours are
/// missing.
constexpr double kMargin = 16.0;

struct Options {
  bool quick = false;

  [[nodiscard]] int block() const { return quick ? 48 : 200; }  // [voxels]
  [[nodiscard]] std::size_t errorPoints() const { return quick ? 2000 : 100000; }
  [[nodiscard]] std::size_t calls() const { return quick ? 2000 : 40000; }
  [[nodiscard]] int rounds() const { return quick ? 2 : 15; }
};

/// The flow with wave number k [rad/voxel], and its Jacobian.
struct Flow {
  double k;

  static constexpr double kA = 1.0;
  static constexpr double kB = 0.8;
  static constexpr double kC = 0.5;

  [[nodiscard]] VectorSample at(const Vec3& p) const {
    const Eigen::Array3d s = (k * p).array().sin();
    const Eigen::Array3d c = (k * p).array().cos();
    VectorSample out;
    out.value = {kA * s[2] + kC * c[1], kB * s[0] + kA * c[2], kC * s[1] + kB * c[0]};
    out.jacobian << 0.0, -kC * s[1], kA * c[2],  //
        kB * c[0], 0.0, -kA * s[2],              //
        -kB * s[0], kC * c[1], 0.0;
    out.jacobian *= k;
    out.inside = true;
    return out;
  }
};

std::shared_ptr<const Volume> makeFlow(int block, const Flow& flow) {
  const test::TemporaryFolder folder;
  const auto grid = test::makeGrid<openvdb::Vec3SGrid>(
      block, openvdb::math::Transform::createLinearTransform(1.0), [&](const Vec3d& p) {
        const Vec3 v = flow.at({p.x(), p.y(), p.z()}).value;
        return openvdb::Vec3s(Vec3d(v.x(), v.y(), v.z()));
      });
  test::writeVdb(folder / "flow.vdb", {grid});
  return loadVolume(folder / "flow.vdb", "");
}

using Read = std::function<Vec3(const Vec3&)>;

template <class Field>
struct Bound {
  explicit Bound(std::shared_ptr<const Field> f)
      : field(std::move(f)), cache(std::make_shared<FieldCache>()) {
    field->reset(*cache);
  }
  auto operator()(const Vec3& p) const { return field->sample(p, *cache); }
  std::shared_ptr<const Field> field;
  std::shared_ptr<FieldCache> cache;
};

FieldPtr fieldOf(const std::shared_ptr<const Volume>& volume, Interpolation interpolation) {
  return makeVdbField(volume, Placement{}, {interpolation});
}

Read onTheFly(const std::shared_ptr<const Volume>& volume, Derivation what,
              Interpolation interpolation) {
  const Bound<VectorField> read(std::get<1>(fieldOf(volume, interpolation)));
  return [read, what](const Vec3& p) { return test::onTheFly(what, read(p)); };
}

Read precomputed(const std::shared_ptr<const Volume>& made) {
  const FieldPtr field = fieldOf(made, Interpolation::kTrilinear);
  if (field.index() == 0) {
    const Bound<ScalarField> read(std::get<0>(field));
    return [read](const Vec3& p) { return Vec3(read(p).value, 0.0, 0.0); };
  }
  const Bound<VectorField> read(std::get<1>(field));
  return [read](const Vec3& p) { return read(p).value; };
}

Vec3 anywhere(test::Random& random, int block) {
  return Vec3::Constant(0.5 * block) + random.inCube(0.5 * block - kMargin);
}

/// Returns the root mean square of the error, divided by that of the exact values.
double errorOf(const Read& read, Derivation what, const Flow& flow, int block, std::size_t points) {
  test::Random random(1);
  double error = 0.0;
  double size = 0.0;
  for (std::size_t i = 0; i < points; ++i) {
    const Vec3 p = anywhere(random, block);
    const Vec3 truth = test::onTheFly(what, flow.at(p));
    error += (read(p) - truth).squaredNorm();
    size += truth.squaredNorm();
  }
  return std::sqrt(error / size);
}

/// Makes a path in steps of 0.05 voxels. Its direction changes slowly; kMargin from an edge, the
/// path turns towards the centre.
std::vector<Vec3> makeWalk(int block, std::size_t steps) {
  constexpr double kStep = 0.05;
  test::Random random(3);
  const Vec3 centre = Vec3::Constant(0.5 * block);
  Vec3 p = centre + Vec3(3.3, 2.1, 1.7);
  Vec3 heading = random.direction();
  std::vector<Vec3> walk;
  for (std::size_t i = 0; i < steps; ++i) {
    heading = (heading + 0.2 * random.direction()).normalized();
    if ((p - centre).cwiseAbs().maxCoeff() > 0.5 * block - kMargin) {
      heading = (centre - p).normalized();
    }
    p += kStep * heading;
    walk.push_back(p);
  }
  return walk;
}

template <class Reader>
double timeCalls(const Reader& read, const std::vector<Vec3>& points) {
  static volatile double keep = 0.0;
  return bench::middleOfBatches(std::span<const Vec3>(points), [&](std::span<const Vec3> batch) {
    double sum = 0.0;
    const auto begin = Clock::now();
    for (const Vec3& p : batch) sum += read(p);
    const std::chrono::duration<double, std::nano> took = Clock::now() - begin;
    keep = keep + sum;
    return took.count();
  });
}

struct Cost {
  double walk = 0.0;
  double random = 0.0;
};
using Timed = std::function<double(const std::vector<Vec3>&)>;

std::vector<Cost> measureCosts(const std::vector<Timed>& contenders, const Options& options) {
  const std::vector<Vec3> walk = makeWalk(options.block(), options.calls());
  test::Random random(4);
  std::vector<Vec3> scatter;
  for (std::size_t i = 0; i < options.calls(); ++i) {
    scatter.push_back(anywhere(random, options.block()));
  }
  const std::size_t n = contenders.size();
  std::vector<std::vector<double>> walks(n);
  std::vector<std::vector<double>> scatters(n);
  for (std::size_t round = 0; round < static_cast<std::size_t>(options.rounds()); ++round) {
    for (std::size_t i = 0; i < n; ++i) {
      const std::size_t which = (i + round) % n;
      walks[which].push_back(contenders[which](walk));
      scatters[which].push_back(contenders[which](scatter));
    }
  }
  std::vector<Cost> costs(n);
  for (std::size_t i = 0; i < n; ++i) {
    costs[i] = {bench::percentile(walks[i], 0.5), bench::percentile(scatters[i], 0.5)};
  }
  return costs;
}

/// Times readings as in a tick: through the field's interface, with all parts of the sample.
Timed timedVector(const std::shared_ptr<const Volume>& volume, Interpolation interpolation,
                  double (*use)(const VectorSample&)) {
  const Bound<VectorField> read(std::get<1>(fieldOf(volume, interpolation)));
  return [read, use](const std::vector<Vec3>& points) {
    return timeCalls([&](const Vec3& p) { return use(read(p)); }, points);
  };
}
Timed timedScalar(const std::shared_ptr<const Volume>& volume) {
  const Bound<ScalarField> read(std::get<0>(fieldOf(volume, Interpolation::kTrilinear)));
  return [read](const std::vector<Vec3>& points) {
    return timeCalls(
        [&](const Vec3& p) {
          const ScalarSample s = read(p);
          return s.value + s.gradient.x();
        },
        points);
  };
}

double useBare(const VectorSample& s) {
  return s.value.x() + s.jacobian(1, 2);
}
double useMagnitude(const VectorSample& s) {
  return s.value.norm() + s.jacobian(1, 2);
}
double useCurl(const VectorSample& s) {
  return curl(s.jacobian).sum();
}
double useQ(const VectorSample& s) {
  return qCriterion(s.jacobian);
}
double useLambda2(const VectorSample& s) {
  return lambda2(s.jacobian);
}
double useAll(const VectorSample& s) {
  return s.value.norm() + curl(s.jacobian).sum() + qCriterion(s.jacobian) + lambda2(s.jacobian);
}

void printCosts(const Options& options) {
  const auto volume = makeFlow(options.block(), Flow{2.0 * M_PI / 16.0});
  const auto make = [&](Derivation what, double& ms) {
    const auto begin = Clock::now();
    auto made = deriveVolume(volume, what);
    ms = std::chrono::duration<double, std::milli>(Clock::now() - begin).count();
    return made;
  };
  double speed_ms = 0.0;
  double core_ms = 0.0;
  double spin_ms = 0.0;
  const auto speed = make(Derivation::kMagnitude, speed_ms);
  const auto core = make(Derivation::kLambda2, core_ms);
  const auto spin = make(Derivation::kCurl, spin_ms);

  struct Row {
    std::string what;
    Timed timed;
    double memory;
    std::string at_load;
  };
  const auto flow = [&](const char* what, double (*use)(const VectorSample&)) -> Row {
    return {what, timedVector(volume, Interpolation::kTrilinear, use), 0.0, ""};
  };
  const auto ms = [](double t) { return std::to_string(std::lround(t)); };
  const std::vector<Row> rows{
      flow("the flow alone: value and Jacobian", useBare),
      flow("+ magnitude, on the fly", useMagnitude),
      flow("+ curl, on the fly", useCurl),
      flow("+ Q, on the fly", useQ),
      flow("+ lambda2, on the fly", useLambda2),
      flow("+ all four, on the fly", useAll),
      {"grid of magnitude: value and gradient", timedScalar(speed),
       static_cast<double>(speed->memory()), ms(speed_ms)},
      {"grid of lambda2: value and gradient", timedScalar(core),
       static_cast<double>(core->memory()), ms(core_ms)},
      {"grid of curl: value and Jacobian", timedVector(spin, Interpolation::kTrilinear, useBare),
       static_cast<double>(spin->memory()), ms(spin_ms)}};
  std::vector<Timed> timed;
  timed.reserve(rows.size());
  for (const Row& row : rows) timed.push_back(row.timed);
  const std::vector<Cost> costs = measureCosts(timed, options);
  std::printf(
      "A dense block of %d³ voxels, %.0f MB as vectors of float; %zu calls, the median of "
      "%d rounds.\n\n",
      options.block(), static_cast<double>(volume->memory()) / kMegabyte, options.calls(),
      options.rounds());
  std::printf("| reading | walk ns | random points ns | memory more MB | at load ms |\n");
  std::printf("|---|--:|--:|--:|--:|\n");
  for (std::size_t i = 0; i < rows.size(); ++i) {
    std::printf("| %s | %.1f | %.0f | %.0f | %s |\n", rows[i].what.c_str(), costs[i].walk,
                costs[i].random, rows[i].memory / kMegabyte, rows[i].at_load.c_str());
  }
}

void printErrors(const Options& options) {
  constexpr std::array kVoxels{8.0, 16.0, 32.0};
  const std::array<std::pair<Derivation, const char*>, 5> kinds{{
      {Derivation::kMagnitude, "magnitude"},
      {Derivation::kUnit, "unit"},
      {Derivation::kCurl, "curl"},
      {Derivation::kQ, "Q"},
      {Derivation::kLambda2, "lambda2"},
  }};
  std::printf("\nError, root mean square by that of the truth [%%].\n\n");
  std::printf(
      "| property | voxels to a wavelength | on the fly, trilinear | grid, trilinear | on "
      "the fly, cubic |\n|---|--:|--:|--:|--:|\n");
  for (const auto& kind : kinds) {
    const Derivation what = kind.first;
    for (const double voxels : kVoxels) {
      const int block = options.quick ? 48 : 96;
      const Flow flow{2.0 * M_PI / voxels};
      const auto volume = makeFlow(block, flow);
      const auto error = [&](const Read& read) {
        return 100.0 * errorOf(read, what, flow, block, options.errorPoints());
      };
      std::printf("| %s | %.0f | %.3g | %.3g | %.3g |\n", kind.second, voxels,
                  error(onTheFly(volume, what, Interpolation::kTrilinear)),
                  error(precomputed(deriveVolume(volume, what))),
                  error(onTheFly(volume, what, Interpolation::kCubic)));
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  try {
    Options options;
    CLI::App app{"Properties of a flow: derived at every reading against read from a grid."};
    app.add_flag("--quick", options.quick, "few points, a small grid, no care for times");
    CLI11_PARSE(app, argc, argv);
    std::printf("%s\n\n", bench::describe(bench::takeMachine()).c_str());
    printCosts(options);
    printErrors(options);
    return 0;
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_derive: %s\n", e.what());
    return 2;
  }
}
