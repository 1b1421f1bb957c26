/// Measures whether energy comes out of the hand's port: palpate_bench_passivity [RUNS [HANDS]].
/// Makes many runs without a passivity controller, with Hannaford and Ryu's observer, and with the
/// energy tank. RUNS (default 20000) is the number of the tank's runs "at random" and "restarted";
/// other rows have a tenth, rows of searches at least 1000. HANDS selects rows by a part of their
/// name.
///
/// Column active: runs in which more energy came out than rounding explains.
/// Column broken: runs in which more energy came out than the tank allows, or in which the tank's
/// energy exceeded the energy put in.
/// Column acts: share of the ticks in which the controller changed the force.
/// Column takes: share of the force that the controller removed (an observer adds force).
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <thread>
#include <vector>

#include "bench/machine.h"
#include "tests/support/passivity_runs.h"

using namespace palpate;
using bench::Keeper;
using bench::PassivityRun;

namespace {

const char* asked_hands = "";
int rows = 0;

/// Prints a row. `play` adds the result of the i-th run to a tally.
template <class Play>
void showThose(const char* what, Keeper keeper, long count, Play play) {
  if (std::strstr(what, asked_hands) == nullptr) return;
  ++rows;
  bench::PassivityTally sum;
  std::mutex mutex;
  std::atomic<long> next{0};
  const auto work = [&] {
    bench::PassivityTally own;
    for (long i = next++; i < count; i = next++) play(static_cast<std::uint64_t>(i), own);
    const std::lock_guard lock(mutex);
    sum.add(own);
  };
  std::vector<std::thread> threads(std::max(1U, std::thread::hardware_concurrency()));
  for (std::thread& thread : threads) thread = std::thread(work);
  for (std::thread& thread : threads) thread.join();
  const double n = static_cast<double>(sum.runs);
  const char* const names[] = {"none", "observer", "tank"};
  std::printf("%-22s %-9s %9ld %9.3f %9.3f %9ld %9ld %11.2e %9.2f %9.2f\n", what,
              names[static_cast<int>(keeper)], sum.runs,
              100.0 * static_cast<double>(sum.active) / n,
              100.0 * static_cast<double>(sum.large) / n, sum.broken, sum.indebted, sum.worst,
              100.0 * sum.scaled / n, 100.0 * sum.lost / n);
  std::fflush(stdout);
}

template <class Change>
void show(const char* what, Keeper keeper, long runs, Change change) {
  showThose(what, keeper, runs, [&](std::uint64_t i, bench::PassivityTally& own) {
    PassivityRun run = bench::randomRun(i, true);
    change(run);
    own.add(bench::play(run, keeper));
  });
}

/// Returns the median time of a tick of the tank [ns].
double cost(double delay, double doubt, double lag, double share) {
  TankParams params;
  params.use = TankUse::kAct;
  params.arm.viscous = 0.5;
  params.arm.coulomb = 0.02;
  params.arm.step = 2e-5;
  params.arm.delay = delay;
  params.arm.doubt = doubt;
  params.arm.lag = lag;
  params.arm.period = 1e-3;
  std::vector<double> times;
  for (int pass = 0; pass < 101; ++pass) {
    Tank tank;
    (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, 1e-3, params, 1.0);
    tank.refill(0.5);
    constexpr int kTicks = 200;
    double sum = 0.0;
    const auto start = bench::Clock::now();
    for (int i = 0; i < kTicks; ++i) {
      const double turn = 0.1 * i;
      // With a share below 1, the force needs more energy than the tank can have.
      const double size = share < 1.0 ? 1e4 : 1.0;
      sum += tank.pass(size * Vec3(std::sin(turn), std::cos(turn), 0.1),
                       1e-5 * Vec3(std::cos(turn), 0, 0), true, 1e-3, params, 1.0);
    }
    const std::chrono::duration<double, std::nano> spent = bench::Clock::now() - start;
    if (sum >= 0.0) times.push_back(spent.count() / kTicks);
  }
  std::nth_element(times.begin(), times.begin() + 50, times.end());
  return times[50];
}

}  // namespace

int main(int argc, char** argv) {
  long runs = 20000;
  char* end = nullptr;
  if (argc > 1) runs = std::strtol(argv[1], &end, 10);
  if (argc > 3 || runs < 1 || (end != nullptr && *end != '\0')) {
    std::fprintf(
        stderr,
        "palpate_bench_passivity: %s: it is not a number of runs, or is one argument too many: "
        "give RUNS, such as 20000, and HANDS\n",
        argv[argc > 3 ? 3 : 1]);
    return 2;
  }
  if (argc == 3) asked_hands = argv[2];
  const bench::Machine machine = bench::takeMachine(false);
  std::printf("%s\n", bench::describe(machine).c_str());
  std::printf(
      "a tick of the tank: %.0f ns, with a delay %.0f, in doubt %.0f, with lag %.0f; "
      "scaling %.0f, %.0f, %.0f, %.0f\n",
      cost(0.0, 0.0, 0.0, 1.0), cost(1.5e-3, 0.0, 0.0, 1.0), cost(1.5e-3, 2e-4, 0.0, 1.0),
      cost(1.5e-3, 2e-4, 2e-4, 1.0), cost(0.0, 0.0, 0.0, 0.5), cost(1.5e-3, 0.0, 0.0, 0.5),
      cost(1.5e-3, 2e-4, 0.0, 0.5), cost(1.5e-3, 2e-4, 2e-4, 0.5));
  std::printf(
      "active: energy came out; broken: more than the tank promises; acts: share of ticks; takes: "
      "of the force\n");
  std::printf("%-22s %-9s %9s %9s %9s %9s %9s %11s %9s %9s\n", "hands", "keeper", "runs",
              "active %", "> 1 mJ %", "broken", "in debt", "worst J", "acts %", "takes %");
  const auto drawn = [](PassivityRun&) {};
  const auto wicked = [](PassivityRun& run) { run.adversary = true; };
  // In half of the runs the hand is an adversary that tries to extract energy.
  const auto lagging = [](PassivityRun& run) {
    bench::letLag(run);
    run.adversary = run.seed % 2 == 0;
  };
  const auto doubtful = [](PassivityRun& run) {
    bench::doubtDelay(run);
    run.adversary = run.seed % 2 == 0;
  };
  const auto shaken = [doubtful](PassivityRun& run) {
    doubtful(run);
    bench::shakeReadings(run);
  };
  const auto untold = [doubtful](PassivityRun& run) {
    doubtful(run);
    run.tells_doubt = false;
  };
  const auto forgetful = [](PassivityRun& run) {
    // Some runs also have the other changes.
    if (run.seed % 3 == 1) bench::doubtDelay(run);
    if (run.seed % 5 == 1) bench::shakeReadings(run);
    if (run.seed % 7 == 1) bench::letLag(run);
    bench::forgetOften(run);
    // forgetOften() uses the lowest five bits of the seed.
    run.adversary = run.seed / 32 % 2 == 0;
    run.jitter = run.seed / 64 % 4 == 0 ? 0.5 : 0.0;
  };
  const auto early = [](PassivityRun& run) {
    run.jitter = 0.9;
    run.adversary = run.seed % 2 == 0;
  };
  const auto late = [](PassivityRun& run) {
    run.late = 0.05;
    run.delay = 0.0;
    run.adversary = run.seed % 2 == 0;
  };
  show("at random", Keeper::kTank, runs, drawn);
  show("adversary", Keeper::kTank, std::max(1L, runs / 10), wicked);
  show("amplifiers that lag", Keeper::kTank, std::max(1L, runs / 10), lagging);
  show("delays in doubt", Keeper::kTank, std::max(1L, runs / 10), doubtful);
  show("... and positions", Keeper::kTank, std::max(1L, runs / 10), shaken);
  show("... and not reported", Keeper::kTank, std::max(1L, runs / 10), untold);
  show("restarted", Keeper::kTank, runs, forgetful);
  constexpr long kPlays = 1000;
  showThose(
      "... and searched", Keeper::kTank, std::max(1L, runs / 10 / kPlays),
      [](std::uint64_t i, bench::PassivityTally& own) { own.add(bench::playSearched(i, kPlays)); });
  showThose("... without delay", Keeper::kTank, std::max(1L, runs / 10 / kPlays),
            [](std::uint64_t i, bench::PassivityTally& own) {
              own.add(bench::playSearched(i, kPlays, true));
            });
  show("ticks come early", Keeper::kTank, std::max(1L, runs / 10), early);
  show("ticks come late", Keeper::kTank, std::max(1L, runs / 10), late);
  for (const Keeper keeper : {Keeper::kNobody, Keeper::kObserver}) {
    show("at random", keeper, std::max(1L, runs / 10), drawn);
    show("adversary", keeper, std::max(1L, runs / 10), wicked);
  }
  if (rows == 0) {
    std::fprintf(stderr,
                 "palpate_bench_passivity: %s: no row has this text in its name: omit HANDS to "
                 "see all rows\n",
                 asked_hands);
    return 2;
  }
}
