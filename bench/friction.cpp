/// Measures the cost of friction, and how often no balance is found. Records motions over one to
/// four rough planes with drags and lines, and balances them with engine/balance/friction.h.
///
///     palpate_bench_friction [MOTIONS]
#include "palpate/engine/balance/friction.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <stdexcept>
#include <string>
#include <vector>

#include "bench/machine.h"
#include "tests/support/percentiles.h"
#include "tests/support/random.h"

namespace {

using namespace palpate;
using bench::Clock;

/// Planes with normals within about 70 degrees of one direction, or a groove whose walls are 10 to
/// 80 degrees from its middle plane.
struct Family {
  const char* name;
  int planes;
  double least_mu;
  double most_mu;
  int drags;
  int lines;
  bool groove;
};
constexpr std::array<Family, 10> kFamilies = {{
    {"1 plane, drag, mu 0.1-1.5", 1, 0.1, 1.5, 1, 0, false},
    {"1 plane, drag, line", 1, 0.1, 1.5, 1, 1, false},
    {"2 planes, mu 0.1-0.6", 2, 0.1, 0.6, 0, 0, false},
    {"2 planes, drag, mu 0.1-0.6", 2, 0.1, 0.6, 1, 0, false},
    {"2 planes, drag, mu 0.6-1.5", 2, 0.6, 1.5, 1, 0, false},
    {"groove, mu 0.8-1.5", 2, 0.8, 1.5, 0, 0, true},
    {"3 planes, drag, mu 0.1-0.6", 3, 0.1, 0.6, 1, 0, false},
    {"3 planes, drag, mu 0.6-1.5", 3, 0.6, 1.5, 1, 0, false},
    {"4 planes, 2 drags, line", 4, 0.1, 0.6, 2, 1, false},
    {"4 planes, drag, mu 0.6-1.5", 4, 0.6, 1.5, 1, 0, false},
}};
constexpr int kTicks = 60;  // per motion
// [m]: largest error of a plane's position along its normal.
constexpr double kReadOff = 1e-6;

struct Plane {
  Vec3 normal;
  double strength;
  double mu;
};

std::vector<Plane> planesOf(const Family& family, test::Random& random) {
  std::vector<Plane> planes;
  const double steep = random.uniform(10.0, 80.0) * M_PI / 180.0;
  const double turned = random.uniform(0.0, 2.0 * M_PI);
  for (int i = 0; i < family.planes; ++i) {
    const double at = turned + i * M_PI;
    Vec3 normal(std::cos(steep) * std::cos(at), std::cos(steep) * std::sin(at), std::sin(steep));
    while (!family.groove) {
      normal = random.direction();
      if (normal.z() > 0.34) break;
    }
    planes.push_back(
        {normal, random.uniform(0.5, 5.0), random.uniform(family.least_mu, family.most_mu)});
  }
  return planes;
}

struct Done {
  std::vector<double> iterations;
  std::vector<double> ns;
  long unfinished = 0;
  double worst = 0.0;  ///< Largest error bound of a balance that did not converge [m].

  void add(const SolveResult& result, double took) {
    iterations.push_back(result.iterations);
    ns.push_back(took);
    if (result.status == SolveStatus::kConverged) return;
    ++unfinished;
    worst = std::max(worst, result.error_bound);
  }
  void print(const char* family) {
    std::sort(iterations.begin(), iterations.end());
    std::sort(ns.begin(), ns.end());
    double sum = 0.0;
    for (const double one : iterations) sum += one;
    std::printf("%-28s %6ld %9.2g %6.1f %5.0f %5.0f %7.2f %7.1f\n", family, unfinished, 1e3 * worst,
                sum / static_cast<double>(iterations.size()),
                bench::percentileOfSorted(iterations, 0.99), iterations.back(),
                1e-3 * bench::percentileOfSorted(ns, 0.5),
                1e-3 * bench::percentileOfSorted(ns, 0.99));
  }
};

/// Throws if a converged balance violates Coulomb's law or does not balance the spring.
void judge(const Vec3& hand, double stiffness, const PrimitiveSet& set, const SolveResult& result,
           const std::vector<Vec3>& forces) {
  if (result.status != SolveStatus::kConverged) return;
  Vec3 left = -stiffness * result.offset;
  for (std::size_t i = 0; i < set.size(); ++i) left += forces[i];
  if (!(left.norm() <= 2.0 * stiffness * result.error_bound + 1e-9)) {
    throw std::runtime_error("forces do not add up to the spring's");
  }
  for (const FrictionLink& link : set.links()) {
    const double load = set.items()[link.plane].direction.dot(forces[link.plane]);
    const double strength = set.items()[link.line].strength;
    if (std::abs(strength - link.coefficient * load) > 1e-8) {
      throw std::runtime_error("a friction is not mu times its load");
    }
  }
  if (!(hand + result.offset).allFinite()) throw std::runtime_error("a proxy is not finite");
}

void move(const Family& family, test::Random& random, Done& done) {
  const double stiffness = random.logUniform(100.0, 2000.0);
  const std::vector<Plane> planes = planesOf(family, random);
  const double drag = random.uniform(0.05, 0.4);
  const Primitive line{PrimitiveKind::kLine, Vec3::Zero(), random.direction(),
                       random.uniform(0.05, 1.0)};
  WarmStart warm;
  FrictionStart last;
  std::vector<Vec3> forces(kMaxPrimitives, Vec3::Zero());
  Vec3 proxy(0.0, 0.0, 1e-4);
  Vec3 hand = proxy;
  Vec3 step = 1e-4 * random.direction();
  step.z() = -std::abs(step.z()) - 5e-5;
  PrimitiveSet set;
  for (int tick = 0; tick < kTicks; ++tick) {
    if (tick % 20 == 19) {
      step = random.uniform(2e-5, 3e-4) * random.direction();
      if (hand.z() > 0.0) step.z() = -std::abs(step.z());
    }
    hand += step;
    set.clear();
    bool room = true;
    for (int i = 0; i < family.drags; ++i) {
      room = set.tryAdd({PrimitiveKind::kPoint, proxy, Vec3::UnitX(), drag}) && room;
    }
    for (const Plane& plane : planes) {
      const Vec3 at = random.uniform(-kReadOff, kReadOff) * plane.normal;
      room = set.tryAdd({PrimitiveKind::kPlane, at, plane.normal, plane.strength}) &&
             set.tryAddFriction(proxy, plane.mu) && room;
    }
    if (family.lines > 0) room = set.tryAdd(line) && room;
    if (!room) throw std::runtime_error("a set is full");
    const auto start = Clock::now();
    const SolveResult result =
        solveWithFriction(hand, stiffness, set, proxy, {}, warm, last, forces);
    const auto end = Clock::now();
    done.add(result, std::chrono::duration<double, std::nano>(end - start).count());
    judge(hand, stiffness, set, result, forces);
    proxy = result.proxy;
  }
}

int run(int argc, char** argv) {
  const int motions = argc > 1 ? std::atoi(argv[1]) : 100;
  if (argc > 2 || motions < 1) {
    std::fprintf(stderr, "usage: palpate_bench_friction [MOTIONS]\n");
    return 2;
  }
  std::printf("%s (included)\n", bench::describe(bench::takeMachine()).c_str());
  std::printf("%d motions of %d ticks a family, planes read up to 1 um off\n", motions, kTicks);
  std::printf("%-28s %6s %9s %6s %5s %5s %7s %7s\n", "balances of", "open", "bound mm", "mean",
              "p99", "max", "p50 us", "p99 us");
  test::Random random(7);
  for (const Family& family : kFamilies) {
    Done done;
    for (int i = 0; i < motions; ++i) move(family, random, done);
    done.print(family.name);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_friction: %s\n", e.what());
    return 1;
  }
}
