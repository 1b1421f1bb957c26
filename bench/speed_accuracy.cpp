/// Compares speed and accuracy of the methods of the literature and of the engine's solver.
/// Measures the time per balance and the error of the proxy, for several settings and families of
/// problems and motions. Also measures iterations over a recorded exploration (figure 7 of Lundin
/// et al.), and the excess force of non-orthogonal constraints (section 3.1 of Lundin et al.).
///
///     palpate_bench_speed_accuracy > speed_accuracy.json
///     bench/speed_accuracy_chart.py speed_accuracy.json docs/charts
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <CLI/CLI.hpp>
#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

#include "bench/cold.h"
#include "bench/exploration.h"
#include "bench/machine.h"
#include "bench/report.h"
#include "palpate/bench/methods/constraint_approach.h"
#include "palpate/engine/balance/solver.h"
#include "tests/support/contenders.h"
#include "tests/support/percentiles.h"
#include "tests/support/reference_solver.h"

namespace {

using namespace palpate;
using namespace palpate::bench;
using nlohmann::ordered_json;

constexpr double kShortest = 5.0;  // [ns]: shorter times are noise of the clock

struct Target {
  const char* word;
  double share;
};
constexpr std::array<Target, 3> kTargets = {{{"1e-2", 1e-2}, {"1e-3", 1e-3}, {"1e-6", 1e-6}}};

struct Options {
  std::size_t problems = 300;
  std::uint64_t seed = 1;
  double seconds = 90.0;      // [s], duration of the timing
  double exploration = 20.0;  // [s] of virtual time
  std::size_t cold = 150;     // balances of a motion that are timed from a cold start
  std::string output;
};

double nanoseconds(Clock::duration d) {
  return std::chrono::duration<double, std::nano>(d).count();
}

struct Row {
  std::string family;
  std::size_t primitives = 0;
  bool motion = false;  // each problem continues the previous one
  std::vector<RecordedBalance> cases;
  std::vector<Vec3> offsets;   // proxy - probe [m]
  std::vector<double> bounds;  // error bounds of the offsets [m]
};

Row makeRow(Family family, int count, const Options& options) {
  Row row;
  row.family = wordFor(family);
  test::Random random(options.seed + 1000 * static_cast<std::uint64_t>(count));
  for (std::size_t i = 0; i < options.problems; ++i) {
    RecordedBalance balance;
    balance.first = true;
    balance.problem = makeProblem(family, count, random);
    row.cases.push_back(std::move(balance));
  }
  return row;
}

std::vector<Row> makeRows(const Options& options, const std::vector<RecordedBalance>& exploration) {
  // A motion consists of up to twenty sections. A section begins with a cold start unless it
  // continues the section before.
  constexpr std::size_t kStretches = 20;
  const std::size_t ticks = std::max<std::size_t>(10, options.problems / 4);
  std::vector<Row> rows;
  for (const Family family : {Family::kRandom, Family::kOnePoint, Family::kNearParallel,
                              Family::kSlot, Family::kOrthogonal}) {
    for (const int count :
         family == Family::kOrthogonal ? std::vector{2, 3} : std::vector{2, 8, 32}) {
      rows.push_back(makeRow(family, count, options));
    }
  }
  const auto add_motion = [&](const char* name, std::vector<RecordedBalance> cases) {
    Row row;
    row.family = name;
    row.motion = true;
    row.cases = std::move(cases);
    rows.push_back(std::move(row));
  };
  for (const int count : {2, 8, 32}) {
    add_motion("walk, fixed",
               recordWalks(Anchoring::kFixed, count, kStretches, ticks, options.seed));
    add_motion("walk, carried",
               recordWalks(Anchoring::kCarried, count, kStretches, ticks, options.seed));
  }
  add_motion("surface and drag", windowsOf(exploration, 2, kStretches, ticks));
  add_motion("surface and stream", windowsOf(recordExploration(Explored::kSurfaceAndStream,
                                                               options.exploration, options.seed),
                                             2, kStretches, ticks));
  for (Row& row : rows) {
    if (row.cases.empty()) throw std::runtime_error("no ticks in contact: raise --exploration");
    row.primitives = row.cases.front().problem.primitives.size();
  }
  return rows;
}

/// Finds the exact answers with the slow reference solver, in quadruple precision. The reference
/// solver shares no code with the measured methods. Throws if an answer is not known to 1e-6 S/k.
ordered_json findTruth(std::vector<Row>& rows) {
  constexpr double kClose = 1e-6;  // share of S/k
  std::size_t cases = 0;
  double widest = 0.0;
  for (Row& row : rows) {
    tell("true answers: " + row.family + ", " + std::to_string(row.primitives));
    for (const RecordedBalance& balance : row.cases) {
      const BalanceProblem& p = balance.problem;
      const test::Reference reference = test::solveReference(p.probe, p.stiffness, p.primitives);
      if (!(reference.error_bound <= kClose * reachOf(p))) {
        throw std::runtime_error("the reference solver is not exact to 1e-6 S/k: " +
                                 test::describe(p.probe, p.stiffness, p.primitives));
      }
      row.offsets.push_back(reference.offset);
      row.bounds.push_back(reference.error_bound);
      ++cases;
      widest = std::max(widest, reference.error_bound / reachOf(p));
    }
  }
  return {{"cases", cases}, {"widest_bound_over_reach", rounded(widest)}};
}

struct Score {
  std::vector<std::vector<double>> times;  // per case, one per pass [ns]
  std::vector<double> cost;                // per case, mean of the middle half [ns]
  std::vector<double> error;  // per case: max(apart, error bound of the exact answer) [m]
  std::vector<double> apart;  // per case: distance to the exact answer [m]
  std::vector<double> iterations;
  std::size_t settled = 0;
  std::size_t claims = 0;  // answers with an error bound
  std::size_t broken = 0;  // answers whose error exceeds their bound
  double spent = 0.0;      // [s]
  int passes = 0;
  std::vector<double> cold;  // times of the first cases under a tick's conditions [ns]
};

/// Times each problem of a row once, so that branches are as hard to predict as in a tick.
void pass(const Contender& contender, const Row& row, double overhead, Score& score) {
  std::vector<Primitive> primitives(row.primitives);
  const auto begin = Clock::now();
  for (std::size_t i = 0; i < row.cases.size(); ++i) {
    const BalanceProblem& problem = row.cases[i].problem;
    if (row.cases[i].first) contender.forget();
    std::copy(problem.primitives.begin(), problem.primitives.end(), primitives.begin());
    const auto start = Clock::now();
    const Answer answer = contender.solve(problem, primitives);
    const auto end = Clock::now();
    score.times[i].push_back(std::max(kShortest, nanoseconds(end - start) - overhead));
    if (score.passes > 0) continue;
    const double apart = (answer.balance.offset - row.offsets[i]).norm();
    // A method that diverges has an infinite error, which JSON cannot express.
    score.apart.push_back(std::isfinite(apart) ? apart : 1e9);
    score.error.push_back(std::max(score.apart.back(), row.bounds[i]));
    score.iterations.push_back(answer.balance.iterations);
    score.settled += static_cast<std::size_t>(answer.balance.settled);
    score.claims += static_cast<std::size_t>(std::isfinite(answer.bound));
    score.broken += static_cast<std::size_t>(score.apart.back() > answer.bound + row.bounds[i]);
  }
  ++score.passes;
  score.spent += 1e-9 * nanoseconds(Clock::now() - begin);
}

/// Returns the time of an empty measurement: of the clock and the call [ns].
double measureOverhead() {
  const Contender nothing{
      "", "", [](const BalanceProblem&, std::span<const Primitive>) { return Answer{}; }};
  Row row;
  row.cases.resize(2000);
  row.offsets.resize(row.cases.size(), Vec3::Zero());
  row.bounds.resize(row.cases.size(), 0.0);
  Score score;
  score.times.resize(row.cases.size());
  pass(nothing, row, 0.0, score);
  std::vector<double> times;
  for (const auto& of_case : score.times) times.push_back(of_case.front());
  return middleHalf(times);
}

/// Measures the contenders in turns, so that other work of the machine affects all equally.
std::vector<Score> measure(const std::vector<Contender>& contenders, const Row& row,
                           double overhead, double seconds_each) {
  constexpr int kPasses = 9;
  std::vector<Score> scores(contenders.size());
  for (Score& score : scores) score.times.resize(row.cases.size());
  for (int turn = 0; turn < kPasses; ++turn) {
    for (std::size_t c = 0; c < contenders.size(); ++c) {
      Score& score = scores[c];
      const double next = turn == 0 ? 0.0 : score.spent / score.passes;
      if (turn > 0 && score.spent + next > seconds_each) continue;
      tell(row.family + ", " + std::to_string(row.primitives) + ": " + contenders[c].method + " " +
           contenders[c].setting);
      pass(contenders[c], row, overhead, score);
    }
  }
  for (Score& score : scores) {
    for (auto& of_case : score.times) score.cost.push_back(middleHalf(of_case));
  }
  return scores;
}

/// Times a motion's first balances as in a tick: after a millisecond of sleep, on a busy core. Only
/// for the engine's solver with warm starts, and the paper's solver.
void measureCold(const std::vector<Contender>& contenders, const Row& row, double overhead,
                 std::size_t most, std::vector<Score>& scores) {
  const Neighbour neighbour("own");
  std::thread loop([&] {
    RealtimeRequest request;
    request.core = loopCore();
    request.lock_memory = false;
    const StayAwake awake(true);
    (void)becomeRealtime(request, awake);
    std::vector<Primitive> primitives(row.primitives);
    for (std::size_t c = 0; c < contenders.size(); ++c) {
      if (contenders[c].method != kOursWarm && contenders[c].method != kPaper) continue;
      for (std::size_t i = 0; i < std::min(most, row.cases.size()); ++i) {
        const BalanceProblem& problem = row.cases[i].problem;
        if (row.cases[i].first) contenders[c].forget();
        sleepUntil(nowNs() + 1'000'000);
        std::copy(problem.primitives.begin(), problem.primitives.end(), primitives.begin());
        const auto start = Clock::now();
        (void)contenders[c].solve(problem, primitives);
        const double took = nanoseconds(Clock::now() - start);
        scores[c].cold.push_back(std::max(kShortest, took - overhead));
      }
    }
  });
  loop.join();
}

/// Returns true if a case is solved to a target, as far as the exact answer is known.
bool reaches(const Row& row, const Score& score, std::size_t i, const Target& target) {
  return score.apart[i] <= target.share * reachOf(row.cases[i].problem) + row.bounds[i];
}

std::size_t countReached(const Row& row, const Score& score, const Target& target) {
  std::size_t count = 0;
  for (std::size_t i = 0; i < row.cases.size(); ++i) {
    count += static_cast<std::size_t>(reaches(row, score, i, target));
  }
  return count;
}

ordered_json describe(const Contender& contender, const Row& row, const Score& score) {
  const auto n = static_cast<double>(row.cases.size());
  ordered_json reached;
  for (const Target& target : kTargets) {
    reached[target.word] = rounded(static_cast<double>(countReached(row, score, target)) / n);
  }
  double floored = 0.0;
  std::vector<double> reach;
  for (std::size_t i = 0; i < row.cases.size(); ++i) {
    reach.push_back(reachOf(row.cases[i].problem));
    floored += static_cast<double>(score.error[i] <= row.bounds[i]) / n;
  }
  return {{"family", row.family},
          {"primitives", row.primitives},
          {"motion", row.motion},
          {"cases", row.cases.size()},
          {"reach_m", rounded(percentile(reach, 0.5))},
          {"method", contender.method},
          {"setting", contender.setting},
          {"cost_ns",
           {{"median", rounded(percentile(score.cost, 0.5))},
            {"p99", rounded(percentile(score.cost, 0.99))}}},
          {"error_m",
           {{"median", rounded(percentile(score.error, 0.5))},
            {"p99", rounded(percentile(score.error, 0.99))},
            {"worst", rounded(percentile(score.error, 1.0))}}},
          {"reached", reached},
          {"at_the_truths_bound", rounded(floored)},
          {"iterations",
           {{"median", percentile(score.iterations, 0.5)},
            {"p99", percentile(score.iterations, 0.99)},
            {"worst", percentile(score.iterations, 1.0)}}},
          {"settled", rounded(static_cast<double>(score.settled) / n)},
          {"certificates", score.claims},
          {"certificates_broken", score.broken},
          {"passes", score.passes}};
}

struct Settings {
  std::string method;
  std::vector<std::size_t> indices;
};

std::vector<Settings> rivalsAmong(const std::vector<Contender>& contenders) {
  std::vector<Settings> rivals;
  for (std::size_t c = 0; c < contenders.size(); ++c) {
    const std::string& method = contenders[c].method;
    if (method == kOurs || method == kOursWarm) continue;
    const auto found = std::find_if(rivals.begin(), rivals.end(),
                                    [&](const Settings& s) { return s.method == method; });
    if (found == rivals.end()) {
      rivals.push_back({method, {c}});
    } else {
      found->indices.push_back(c);
    }
  }
  return rivals;
}

/// Returns the reliable setting with the smallest median cost. A setting is reliable if its share
/// of cases that reach the target is at most one percentage point below the largest share of any
/// setting.
std::size_t bestSetting(const Settings& settings, const Row& row, const std::vector<Score>& scores,
                        const Target& target) {
  std::size_t most = 0;
  for (const std::size_t c : settings.indices) {
    most = std::max(most, countReached(row, scores[c], target));
  }
  std::size_t best = settings.indices.front();
  double least = std::numeric_limits<double>::infinity();
  for (const std::size_t c : settings.indices) {
    const double cost = percentile(scores[c].cost, 0.5);
    const bool reliable = 100 * (most - countReached(row, scores[c], target)) <= row.cases.size();
    if (!reliable || cost >= least) continue;
    best = c;
    least = cost;
  }
  return best;
}

/// Compares the engine's solver with every other method at its best setting for a target, over the
/// cases in which both reach the target. Also writes the missed cases and two more ratios. The
/// first ratio uses the cheapest setting of each case. No program can make this choice, so the
/// first ratio favours the other method. The second ratio covers all cases.
void addRatios(const std::vector<Contender>& contenders, const Row& row,
               const std::vector<Score>& scores, ordered_json& ratios) {
  for (std::size_t o = 0; o < contenders.size(); ++o) {
    if (contenders[o].method != kOurs && contenders[o].method != kOursWarm) continue;
    const auto* const target = std::find_if(kTargets.begin(), kTargets.end(), [&](const Target& t) {
      return contenders[o].setting == t.word;
    });
    if (target == kTargets.end()) continue;
    for (const Settings& rival : rivalsAmong(contenders)) {
      const std::size_t best = bestSetting(rival, row, scores, *target);
      std::vector<double> ours, theirs, ratio, luckiest, regardless;
      std::size_t missed_by_all = 0;
      for (std::size_t i = 0; i < row.cases.size(); ++i) {
        const bool reached = reaches(row, scores[o], i, *target);
        double least = std::numeric_limits<double>::infinity();
        for (const std::size_t c : rival.indices) {
          if (reaches(row, scores[c], i, *target)) least = std::min(least, scores[c].cost[i]);
        }
        missed_by_all += static_cast<std::size_t>(!std::isfinite(least));
        if (reached && std::isfinite(least)) luckiest.push_back(least / scores[o].cost[i]);
        regardless.push_back(scores[best].cost[i] / scores[o].cost[i]);
        if (!reached || !reaches(row, scores[best], i, *target)) continue;
        ours.push_back(scores[o].cost[i]);
        theirs.push_back(scores[best].cost[i]);
        ratio.push_back(theirs.back() / ours.back());
      }
      const double our_sum = std::accumulate(ours.begin(), ours.end(), 0.0);
      const double their_sum = std::accumulate(theirs.begin(), theirs.end(), 0.0);
      ratios.push_back(
          {{"family", row.family},
           {"primitives", row.primitives},
           {"motion", row.motion},
           {"target", target->word},
           {"ours", contenders[o].method},
           {"other", rival.method},
           {"setting", contenders[best].setting},
           {"cases", row.cases.size()},
           {"both", ratio.size()},
           {"missed_by_ours", row.cases.size() - countReached(row, scores[o], *target)},
           {"missed_by_other", row.cases.size() - countReached(row, scores[best], *target)},
           {"missed_by_all_its_settings", missed_by_all},
           {"ours_median_ns", rounded(percentile(ours, 0.5))},
           {"other_median_ns", rounded(percentile(theirs, 0.5))},
           {"ratio",
            {{"p10", rounded(percentile(ratio, 0.1))},
             {"median", rounded(percentile(ratio, 0.5))},
             {"p90", rounded(percentile(ratio, 0.9))},
             {"of_sums", rounded(our_sum > 0.0 ? their_sum / our_sum : 0.0)},
             {"luckiest_setting_median", rounded(percentile(luckiest, 0.5))},
             {"missed_or_not_median", rounded(percentile(regardless, 0.5))}}}});
    }
  }
}

/// Returns the data of figure 7: iterations and the hand's speed in each tick.
ordered_json figure7(const std::vector<RecordedBalance>& exploration) {
  std::vector<double> speed;
  std::vector<std::size_t> primitives;
  for (const RecordedBalance& tick : exploration) {
    speed.push_back(rounded(tick.speed));
    primitives.push_back(tick.problem.primitives.size());
  }
  ordered_json solvers = ordered_json::array();
  for (const Contender& contender : makeFigure7Contenders()) {
    tell("figure 7: " + contender.method);
    contender.forget();
    std::vector<int> iterations;
    std::vector<double> in_contact;
    for (const RecordedBalance& tick : exploration) {
      const methods::Balance balance =
          contender.solve(tick.problem, tick.problem.primitives).balance;
      iterations.push_back(balance.iterations);
      if (tick.problem.primitives.size() == 2) in_contact.push_back(balance.iterations);
    }
    solvers.push_back({{"method", contender.method},
                       {"setting", contender.setting},
                       {"two_primitives",
                        {{"ticks", in_contact.size()},
                         {"median", percentile(in_contact, 0.5)},
                         {"p99", percentile(in_contact, 0.99)},
                         {"worst", percentile(in_contact, 1.0)}}},
                       {"iterations", iterations}});
  }
  return {
      {"rate_hz", 1000}, {"speed_m_s", speed}, {"primitives", primitives}, {"solvers", solvers}};
}

/// Repeats section 3.1 with three constraints: two at an angle, one orthogonal to both. All
/// constraints pass through the proxy, and the hand is 5 mm away, in many directions. The excess
/// force is the difference from the force of the exact balance. The exact balance uses two planes
/// for each constraint, one for each sense of its direction.
ordered_json nonorthogonal(const Options& options) {
  constexpr double kStiffness = 500.0;
  constexpr double kAway = 5e-3;  // [m]
  const std::size_t directions = std::clamp<std::size_t>(options.problems / 5, 4, 100);
  ordered_json curves = ordered_json::array();
  for (const double strength : {0.0, 0.01, 0.1}) {
    tell("section 3.1");
    std::vector<double> angles, old_median, old_worst, our_median, our_worst, felt;
    for (int degrees = 90; degrees >= 1; --degrees) {
      const double angle = degrees * M_PI / 180.0;
      test::Random random(options.seed);
      std::vector<double> old_way;
      std::vector<double> ours;
      double largest = 0.0;
      for (std::size_t i = 0; i < directions; ++i) {
        const Mat3 frame = Eigen::Quaterniond::FromTwoVectors(Vec3::UnitZ(), random.direction())
                               .toRotationMatrix();
        const std::array<Vec3, 3> along = {
            frame.col(0), std::cos(angle) * frame.col(0) + std::sin(angle) * frame.col(1),
            frame.col(2)};
        const Vec3 proxy = random.inCube(1e-2);
        const Vec3 probe = proxy + kAway * random.direction();
        std::vector<methods::Constraint> constraints;
        std::vector<Primitive> planes;
        for (const Vec3& q : along) {
          constraints.push_back({q, strength});
          planes.push_back({PrimitiveKind::kPlane, proxy, q, strength});
          planes.push_back({PrimitiveKind::kPlane, proxy, -q, strength});
        }
        const Vec3 truth =
            strength > 0.0
                ? Vec3(kStiffness * test::solveReference(probe, kStiffness, planes).offset)
                : Vec3(Vec3::Zero());
        const Vec3 moved = methods::constraintProxy(probe, proxy, kStiffness, constraints);
        old_way.push_back((kStiffness * (moved - probe) - truth).norm());
        const Vec3 offset = solveProxy(probe, kStiffness, planes, proxy).offset;
        ours.push_back((kStiffness * offset - truth).norm());
        largest = std::max(largest, truth.norm());
      }
      angles.push_back(degrees);
      old_median.push_back(rounded(percentile(old_way, 0.5)));
      old_worst.push_back(rounded(percentile(old_way, 1.0)));
      our_median.push_back(rounded(percentile(ours, 0.5)));
      our_worst.push_back(rounded(percentile(ours, 1.0)));
      felt.push_back(rounded(largest));
    }
    curves.push_back({{"strength_n", strength},
                      {"degrees", angles},
                      {"constraint_approach_n", {{"median", old_median}, {"worst", old_worst}}},
                      {"palpate_n", {{"median", our_median}, {"worst", our_worst}}},
                      {"largest_true_force_n", felt}});
  }
  return {{"stiffness_n_m", kStiffness},
          {"hand_away_m", kAway},
          {"directions", directions},
          {"curves", curves}};
}

int run(const Options& options) {
  const Machine machine = takeMachine();
  const double overhead = measureOverhead();
  const auto exploration =
      recordExploration(Explored::kSurfaceAndDrag, options.exploration, options.seed);
  std::vector<Row> rows = makeRows(options, exploration);
  const ordered_json truth = findTruth(rows);

  std::size_t cells = 0;
  for (const Row& row : rows) cells += makeContenders(row.motion).size();
  ordered_json results = ordered_json::array();
  ordered_json ratios = ordered_json::array();
  for (const Row& row : rows) {
    const std::vector<Contender> contenders = makeContenders(row.motion);
    std::vector<Score> scores =
        measure(contenders, row, overhead, options.seconds / static_cast<double>(cells));
    if (row.motion) measureCold(contenders, row, overhead, options.cold, scores);
    for (std::size_t c = 0; c < contenders.size(); ++c) {
      results.push_back(describe(contenders[c], row, scores[c]));
      if (scores[c].cold.empty()) continue;
      results.back()["cold_ns"] = rounded(percentile(scores[c].cold, 0.5));
    }
    addRatios(contenders, row, scores, ratios);
  }

  ordered_json where = asJson(machine);
  where["clock_reading_ns"] = rounded(overhead);
  const ordered_json result = {{"machine", where},
                               {"options",
                                {{"problems", options.problems},
                                 {"seed", options.seed},
                                 {"seconds", options.seconds},
                                 {"exploration_s", options.exploration}}},
                               {"truth", truth},
                               {"results", results},
                               {"ratios", ratios},
                               {"figure7", figure7(exploration)},
                               {"nonorthogonal", nonorthogonal(options)}};
  tell("");
  writeResult(result, options.output);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    Options options;
    CLI::App app{"Time per balance against error of the proxy, method by method; writes JSON."};
    app.add_option("--problems", options.problems,
                   "of a family and a number of primitives; motions "
                   "have five times as many ticks")
        ->check(CLI::Range(1, 1000000))
        ->capture_default_str();
    app.add_option("--seed", options.seed, "of all random input")->capture_default_str();
    app.add_option("--seconds", options.seconds,
                   "to spend on timing; each problem is solved at least once")
        ->check(CLI::NonNegativeNumber)
        ->capture_default_str();
    app.add_option("--exploration", options.exploration,
                   "seconds of virtual time, for figure 7 and two motions")
        ->check(CLI::Range(1.0, 600.0))
        ->capture_default_str();
    app.add_option("--cold", options.cold, "balances of a motion that are timed cold; 0: none")
        ->capture_default_str();
    app.add_option("--output", options.output, "a file instead of standard output");
    CLI11_PARSE(app, argc, argv);
    return run(options);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "palpate_bench_speed_accuracy: %s\n", e.what());
    return 2;
  }
}
