/// How often does a balance miss its tolerance, and what does it cost? Random problems of eight
/// families, by number of primitives: iterations, the share at the iteration limit, the largest
/// certified bound, and the mean time.
///
///     palpate_bench_balance [PROBLEMS_PER_ROW]
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <string>
#include <vector>

#include "engine/solver.h"

namespace {

using namespace palpate;

struct Problem {
  Vec3 probe;
  double stiffness;
  std::vector<Primitive> primitives;
};

class Generator {
 public:
  Problem make(const std::string& family, int count) {
    Problem problem;
    problem.stiffness = std::pow(10.0, 1.5 + 2.5 * unit_(engine_));
    const Vec3 anchor = cube(2e-3);
    const Vec3 axis = direction();
    for (int i = 0; i < count; ++i) {
      Primitive p;
      p.kind = static_cast<PrimitiveKind>(engine_() % 4);
      p.position = cube(2e-3);
      p.direction = direction();
      p.strength = 3.0 * unit_(engine_);
      if (family == "one point" || family == "near-parallel") p.position = anchor;
      if (family == "near-parallel") p.direction = (axis + 1e-2 * cube(1.0)).normalized();
      if (family == "slot") {
        p.kind = PrimitiveKind::kPlane;
        p.direction = i % 2 == 0 ? axis : Vec3(-axis);
        p.position = anchor + (i % 2 == 0 ? 0.0 : 1e-6) * axis;
      }
      if (family == "strengths 1e-4 to 1e2") p.strength = std::pow(10.0, -4 + 6 * unit_(engine_));
      if (family == "planes") p.kind = PrimitiveKind::kPlane;
      if (family == "near kinks") {
        p.position = anchor + std::pow(10.0, -16 + 14 * unit_(engine_)) * direction();
      }
      problem.primitives.push_back(p);
    }
    problem.probe = family == "probe on a kink" ? problem.primitives[0].position : cube(5e-3);
    return problem;
  }

 private:
  Vec3 cube(double half) {
    const auto coordinate = [&] { return half * (2.0 * unit_(engine_) - 1.0); };
    const double x = coordinate();
    const double y = coordinate();
    return {x, y, coordinate()};
  }
  Vec3 direction() {
    for (;;) {
      const Vec3 v = cube(1.0);
      if (v.norm() > 0.1 && v.norm() < 1.0) return v.normalized();
    }
  }
  std::mt19937_64 engine_{1};
  std::uniform_real_distribution<double> unit_{0.0, 1.0};
};

void run(const std::string& family, int count, long problems) {
  Generator generator;
  std::vector<Problem> set;
  for (long i = 0; i < problems; ++i) set.push_back(generator.make(family, count));
  std::vector<int> iterations;
  long missed = 0;
  double worst = 0.0;
  double total = 0.0;
  const auto start = std::chrono::steady_clock::now();
  for (const Problem& p : set) {
    const SolveResult r = solveProxy(p.probe, p.stiffness, p.primitives, p.probe);
    iterations.push_back(r.iterations);
    missed += static_cast<long>(r.status != SolveStatus::kConverged);
    worst = std::max(worst, r.error_bound);
    total += r.iterations;
  }
  const auto end = std::chrono::steady_clock::now();
  std::sort(iterations.begin(), iterations.end());
  const auto n = static_cast<double>(problems);
  std::printf("%-22s %4d %10ld %8.2f %6d %6d %8ld %10.1e %8.0f\n", family.c_str(), count, problems,
              total / n, iterations[static_cast<std::size_t>(0.99 * (n - 1))], iterations.back(),
              missed, worst, std::chrono::duration<double, std::nano>(end - start).count() / n);
}

}  // namespace

int main(int argc, char** argv) {
  const long problems = argc > 1 ? std::max(1L, std::atol(argv[1])) : 20000;
  std::printf("%-22s %4s %10s %8s %6s %6s %8s %10s %8s\n", "family", "n", "problems", "iter.",
              "p99", "max", "missed", "bound m", "ns");
  for (const char* family : {"random", "one point", "near-parallel", "slot",
                             "strengths 1e-4 to 1e2", "planes", "probe on a kink", "near kinks"}) {
    for (const int count : {1, 2, 3, 4, 8, 32}) {
      run(family, count, count > 8 ? std::max(1L, problems / 4) : problems);
    }
  }
}
