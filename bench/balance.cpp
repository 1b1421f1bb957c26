/// Measures the cost of a balance on random problems of every family, from a cold start. Prints
/// times, the largest certified error bound relative to S/k, and the number of solves that do not
/// converge.
///
///     palpate_bench_balance [PROBLEMS_PER_ROW [TOLERANCE]]
#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "bench/machine.h"
#include "palpate/engine/balance/solver.h"
#include "tests/support/percentiles.h"
#include "tests/support/problems.h"

namespace {

using namespace palpate;

struct Totals {
  long problems = 0;
  long missed = 0;
  long above_25 = 0;
  int most = 0;
};

/// Solves each problem once per pass, so that the branch prediction does not adapt to a single
/// problem. A problem's time is the median over the passes, minus the clock's smallest step.
void run(bench::Family family, int count, long problems, const SolverParams& params,
         double clock_step, Totals& totals) {
  constexpr int kPasses = 5;
  test::Random random(1);
  std::vector<bench::BalanceProblem> set;
  for (long i = 0; i < problems; ++i) set.push_back(bench::makeProblem(family, count, random));
  std::vector<std::array<double, kPasses>> passes(set.size());
  std::vector<SolveResult> answers(set.size());
  for (std::size_t pass = 0; pass < kPasses; ++pass) {
    for (std::size_t i = 0; i < set.size(); ++i) {
      const bench::BalanceProblem& p = set[i];
      const auto start = bench::Clock::now();
      answers[i] = solveProxy(p.probe, p.stiffness, p.primitives, p.start, params);
      const std::chrono::duration<double, std::nano> spent = bench::Clock::now() - start;
      passes[i][pass] = std::max(1.0, spent.count() - clock_step);
    }
  }

  std::vector<double> times;
  std::vector<double> iterations;
  long missed = 0;
  double worst = 0.0;
  double total = 0.0;
  for (std::size_t i = 0; i < set.size(); ++i) {
    const SolveResult& r = answers[i];
    std::sort(passes[i].begin(), passes[i].end());
    times.push_back(passes[i][kPasses / 2]);
    iterations.push_back(r.iterations);
    total += r.iterations;
    missed += static_cast<long>(r.status != SolveStatus::kConverged);
    totals.above_25 += static_cast<long>(r.iterations > 25);
    totals.most = std::max(totals.most, r.iterations);
    const double reach = bench::reachOf(set[i]);
    if (reach > 0.0) worst = std::max(worst, r.error_bound / reach);
  }
  totals.problems += problems;
  totals.missed += missed;
  std::sort(iterations.begin(), iterations.end());
  std::sort(times.begin(), times.end());
  std::printf("%-22s %5d %9ld %7.2f %5.0f %5.0f %7ld %10.1e %8.0f %8.0f %8.0f %8.0f\n",
              bench::wordFor(family), count, problems, total / static_cast<double>(problems),
              bench::percentileOfSorted(iterations, 0.99), iterations.back(), missed, worst,
              bench::percentileOfSorted(times, 0.5), bench::percentileOfSorted(times, 0.99),
              bench::percentileOfSorted(times, 0.999), times.back());
}

}  // namespace

int main(int argc, char** argv) {
  const long problems = argc > 1 ? std::max(1L, std::atol(argv[1])) : 4000;
  SolverParams params;
  if (argc > 2) params.tolerance = std::atof(argv[2]);
  const bench::Machine machine = bench::takeMachine();
  std::printf("%s\n", bench::describe(machine).c_str());
  std::printf("%-22s %5s %9s %7s %5s %5s %7s %10s %8s %8s %8s %8s\n", "family", "n", "problems",
              "iter.", "p99", "max", "missed", "bound k/S", "p50 ns", "p99 ns", "p99.9 ns",
              "max ns");
  Totals totals;
  for (const bench::Family family : bench::kFamilies) {
    for (const int count : {1, 2, 3, 4, 8, 32, 128, 1024}) {
      // An orthogonal set has at most three primitives.
      if (family == bench::Family::kOrthogonal && count > 3) break;
      run(family, count, std::max(1L, problems * 8 / std::max(8, count)), params,
          machine.clock_step, totals);
    }
  }
  std::printf("%ld problems, %ld missed, at most %d iterations, %ld above 25\n", totals.problems,
              totals.missed, totals.most, totals.above_25);
}
