/// What does one balance cost, and does it ever miss? Random problems of every family, by number of
/// primitives, from a cold start: solves, the largest certified bound, the time of single balances.
///
///     palpate_bench_balance [PROBLEMS_PER_ROW [TOLERANCE]]
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "bench/problems.h"
#include "engine/solver.h"

namespace {

using namespace palpate;
using Clock = std::chrono::steady_clock;

double share(std::vector<double>& sorted, double p) {
  return sorted[static_cast<std::size_t>(p * static_cast<double>(sorted.size() - 1))];
}

struct Totals {
  long problems = 0;
  long missed = 0;
  long above_25 = 0;
  int most = 0;
};

void run(bench::Family family, int count, long problems, const SolverParams& params,
         Totals& totals) {
  // Each balance is timed as the quickest of a few in a row: what the clock costs shows in none.
  constexpr int kRows = 3;
  constexpr int kInARow = 4;
  test::Random random(1);
  std::vector<double> iterations;
  std::vector<double> times;
  long missed = 0;
  double worst = 0.0;
  double total = 0.0;
  for (long i = 0; i < problems; ++i) {
    const bench::BalanceProblem p = bench::makeProblem(family, count, random);
    SolveResult r;
    double quickest = 1e300;
    for (int row = 0; row < kRows; ++row) {
      const auto start = Clock::now();
      for (int j = 0; j < kInARow; ++j) {
        r = solveProxy(p.probe, p.stiffness, p.primitives, p.start, params);
      }
      const std::chrono::duration<double, std::nano> spent = Clock::now() - start;
      quickest = std::min(quickest, spent.count() / kInARow);
    }
    times.push_back(quickest);
    iterations.push_back(r.iterations);
    total += r.iterations;
    missed += static_cast<long>(r.status != SolveStatus::kConverged);
    totals.above_25 += static_cast<long>(r.iterations > 25);
    totals.most = std::max(totals.most, r.iterations);
    const double reach = bench::reachOf(p);
    if (reach > 0.0) worst = std::max(worst, r.error_bound / reach);
  }
  totals.problems += problems;
  totals.missed += missed;
  std::sort(iterations.begin(), iterations.end());
  std::sort(times.begin(), times.end());
  std::printf("%-22s %5d %9ld %7.2f %5.0f %5.0f %7ld %10.1e %8.0f %8.0f\n", bench::wordFor(family),
              count, problems, total / static_cast<double>(problems), share(iterations, 0.99),
              iterations.back(), missed, worst, share(times, 0.5), share(times, 0.99));
}

}  // namespace

int main(int argc, char** argv) {
  const long problems = argc > 1 ? std::max(1L, std::atol(argv[1])) : 4000;
  SolverParams params;
  if (argc > 2) params.tolerance = std::atof(argv[2]);
  std::printf("%-22s %5s %9s %7s %5s %5s %7s %10s %8s %8s\n", "family", "n", "problems", "iter.",
              "p99", "max", "missed", "bound k/S", "p50 ns", "p99 ns");
  Totals totals;
  for (const bench::Family family : bench::kFamilies) {
    for (const int count : {1, 2, 3, 4, 8, 32, 128, 1024}) {
      // Orthogonal sets hold three at most.
      if (family == bench::Family::kOrthogonal && count > 3) break;
      run(family, count, std::max(1L, problems * 8 / std::max(8, count)), params, totals);
    }
  }
  std::printf("%ld problems, %ld missed, at most %d iterations, %ld above 25\n", totals.problems,
              totals.missed, totals.most, totals.above_25);
}
