/// Tests the energy tank: unless ticks are late, no random hand, arm or scene extracts energy from
/// a loop with an energy tank. In control runs without a tank, or with a tank that gets wrong data,
/// some hands gain energy.
#include "palpate/engine/safety/passivity.h"

#include <cmath>
#include <cstdlib>
#include <deque>
#include <limits>
#include <random>
#include <utility>

#include <catch2/catch.hpp>

#include "tests/support/passivity_runs.h"
#include "tests/support/random.h"

namespace palpate::passivity_test {
using bench::Keeper;
using bench::PassivityResult;
using bench::PassivityRun;

namespace {

TankParams acting(double viscous, double coulomb = 0.0, double step = 0.0) {
  TankParams params;
  params.use = TankUse::kAct;
  params.arm.viscous = viscous;
  params.arm.coulomb = coulomb;
  params.arm.step = step;
  params.arm.period = 1e-3;
  return params;
}

constexpr double kCap = 1.0;

using Many = bench::PassivityTally;

double activeShare(const Many& many) {
  return static_cast<double>(many.active) / static_cast<double>(many.runs);
}

template <class Change>
Many playMany(long count, Keeper keeper, Change change, bool fractional = true) {
  Many many;
  for (long i = 0; i < count; ++i) {
    PassivityRun run = bench::randomRun(static_cast<std::uint64_t>(i), fractional);
    change(run);
    many.add(bench::play(run, keeper));
  }
  return many;
}

constexpr auto kAsDrawn = [](PassivityRun&) {};

}  // namespace

TEST_CASE("no scene gives a hand energy with an energy tank but some do with a passivity observer",
          "[passivity]") {
  const long count = test::cases(400);
  const Many tank = playMany(count, Keeper::kTank, kAsDrawn);
  const Many nobody = playMany(count, Keeper::kNobody, kAsDrawn);
  const Many observer = playMany(count, Keeper::kObserver, kAsDrawn);
  INFO("share of " << count << " runs that give energy: " << activeShare(nobody)
                   << ", with an observer " << activeShare(observer) << " (worst " << observer.worst
                   << " J), with the tank " << activeShare(tank) << " (worst " << tank.worst
                   << " J)");
  CHECK(tank.broken == 0);
  CHECK(tank.debt == 0.0);
  CHECK(activeShare(nobody) > 0.25);
  CHECK(activeShare(observer) > 0.25);
  CHECK(nobody.worst < -1e-3);
  CHECK(observer.worst < -1e-3);
}

TEST_CASE("no adversarial hand extracts energy from the energy tank", "[passivity]") {
  const auto wicked = [](PassivityRun& run) {
    run.adversary = true;
    run.seconds = 1.0;
  };
  const long count = test::cases(400);
  const Many tank = playMany(count, Keeper::kTank, wicked);
  const Many nobody = playMany(count, Keeper::kNobody, wicked);
  INFO("share of runs that give energy without a tank "
       << activeShare(nobody) << ", with the tank worst " << tank.worst << " J, margin [J] "
       << tank.margin);
  CHECK(tank.broken == 0);
  CHECK(tank.debt == 0.0);
  CHECK(activeShare(nobody) > 0.25);
}

TEST_CASE("with a lagging amplifier no hand extracts energy from the energy tank", "[passivity]") {
  for (const bool adversary : {false, true}) {
    const auto lagging = [&](PassivityRun& run) {
      run.adversary = adversary;
      bench::letLag(run);
      run.seconds = 1.0;
    };
    const Many tank = playMany(test::cases(120), Keeper::kTank, lagging);
    INFO("worst " << tank.worst << " J, margin [J] " << tank.margin);
    CHECK(tank.broken == 0);
    CHECK(tank.debt == 0.0);
  }
}

namespace {

/// Runs `count` passive hands and as many adversaries. Requires that no hand gains energy if the
/// tank knows the uncertainty that `doubt` sets, and that some hands do otherwise.
template <class Doubt>
void onlyWhereTold(long count, Doubt doubt) {
  for (const bool adversary : {false, true}) {
    const auto doubted = [&](PassivityRun& run) {
      doubt(run);
      run.adversary = adversary;
      run.jitter = run.seed % 8 == 0 ? 0.5 : 0.0;
      run.seconds = 1.0;
    };
    const Many told = playMany(test::cases(count), Keeper::kTank, doubted);
    INFO("adversary " << adversary << ": worst " << told.worst << " J, margin [J] " << told.margin);
    CHECK(told.broken == 0);
    CHECK(told.debt == 0.0);
    const Many untold = playMany(count, Keeper::kTank, [&](PassivityRun& run) {
      doubted(run);
      run.tells_doubt = false;
    });
    INFO("uncertainty not told: " << untold.active << " runs give energy, worst " << untold.worst
                                  << " J");
    CHECK(untold.broken > 0);
  }
}

}  // namespace

TEST_CASE(
    "a force delay of uncertain length gives no energy if the energy tank knows the uncertainty",
    "[passivity][release]") {
  onlyWhereTold(240, [](PassivityRun& run) {
    bench::doubtDelay(run);
    run.every = run.seed % 16 == 1 ? 3 : 1;
  });
}

TEST_CASE("jittered times of position readings give no energy if the energy tank knows the jitter",
          "[passivity][release]") {
  onlyWhereTold(160, [](PassivityRun& run) {
    bench::shakeReadings(run);
    run.doubt = run.seed % 3 == 0 ? 0.0 : std::min(run.delay, 0.4 * run.period);
    if (run.seed % 4 < 2) run.lag = 0.2 * run.period;
  });
}

namespace {

/// One axis of an arm, simulated exactly, with a tank. Forces may act earlier or later than at the
/// middle of the range of delays that the tank assumes.
class Doubted {
 public:
  static constexpr double kPeriod = 1e-3;
  static constexpr double kViscous = 0.5;

  Doubted(double delay, double doubt) : params_(acting(kViscous)), delay_(delay) {
    params_.arm.delay = delay;
    params_.arm.doubt = doubt;
    (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, kPeriod, params_, kHolds);
    tank.refill(energy_);
    send(0.0, -doubt);
  }
  /// Sends the share `given` of a force [N], which acts `late` [s] after the middle of the range of
  /// delays. Then the hand moves for a period at `speed` [m/s], plus `greed` times the speed that
  /// gains the most energy against viscous friction.
  void tick(double force, double late, double speed, double greed, double given = 1.0) {
    ask(force);
    tank.weaken(given, params_.arm);
    send(given * force, late);
    move(speed, greed);
  }
  /// Requests a force [N] from the tank. Returns the smallest value so far of the true energy minus
  /// the tank's energy [J].
  double spare(double force) {
    ask(force);
    return spare_;
  }
  /// Raises the force slowly to 10 N and keeps it there, until all delayed forces are 10 N.
  void settle() {
    for (int i = 1; i <= 1000; ++i) tick(0.01 * i, 0.0, 0.0, 0.0);
    for (int i = 0; i < 4; ++i) tick(10.0, 0.0, 0.0, 0.0);
  }

  Tank tank;

 private:
  static constexpr double kHolds = 100.0;  // [J]

  void ask(double force) {
    const double share = tank.pass({force, 0, 0}, {x_, 0, 0}, true, kPeriod, params_, kHolds);
    REQUIRE(share == 1.0);
    spare_ = std::min(spare_, energy_ - tank.energy());
  }
  void send(double force, double late) { orders_.push_back({time_ + delay_ + late, force}); }
  void move(double speed, double greed) {
    const double end = time_ + kPeriod;
    while (time_ < end - 1e-15) {
      while (!orders_.empty() && orders_.front().first <= time_ + 1e-12) {
        force_ = orders_.front().second;
        orders_.pop_front();
      }
      const double until = orders_.empty() ? end : std::min(end, orders_.front().first);
      const double v = speed + greed * force_ / (2.0 * kViscous);
      energy_ += (until - time_) * (kViscous * v * v - force_ * v);
      x_ += (until - time_) * v;
      time_ = until;
    }
  }

  TankParams params_;
  double delay_;
  double energy_ = 10.0;  // [J]
  double spare_ = 1e9;
  double x_ = 0.0;
  double force_ = 0.0;
  double time_ = 0.0;
  std::deque<std::pair<double, double>> orders_;
};

}  // namespace

TEST_CASE("the tank counts each energy cost of an uncertain delay", "[passivity]") {
  // If any term of the tank's formula is left out, the hand of one section extracts millijoules
  // more than the tank counts.
  constexpr double kT = Doubted::kPeriod;
  constexpr double kRounding = 1e-12;  // [J]
  SECTION("the hand moves while the start of a force is uncertain") {
    Doubted hand(0.5 * kT, 0.5 * kT);
    hand.tick(0.0, 0.0, 0.0, 0.0);
    hand.tick(1.0, -0.5 * kT, 10.0, 0.0);
    CHECK(hand.spare(1.0) >= -kRounding);
  }
  SECTION("the force during a period varies about its mean") {
    Doubted hand(kT, 0.5 * kT);
    hand.tick(0.0, 0.0, 0.0, 0.0);
    hand.tick(10.0, 0.5 * kT, 0.0, 0.0);
    hand.tick(10.0, 0.5 * kT, -5.0, 1.0);
    CHECK(hand.spare(10.0) >= -kRounding);
  }
  SECTION("an old force acts longer than the mean delay") {
    Doubted hand(2.0 * kT, 0.5 * kT);
    hand.settle();
    hand.tick(0.0, 0.5 * kT, 0.0, 0.0);
    hand.tick(0.0, 0.5 * kT, 0.0, 1.0);
    hand.tick(0.0, 0.5 * kT, 0.0, 1.0);
    CHECK(hand.spare(0.0) >= -kRounding);
  }
  SECTION("the uncertainty lasts into the next period") {
    Doubted hand(0.8 * kT, 0.5 * kT);
    hand.tick(0.0, 0.0, 0.0, 0.0);
    hand.tick(10.0, 0.5 * kT, 0.0, 0.0);
    hand.tick(10.0, 0.5 * kT, -30.0, 0.0);
    CHECK(hand.spare(10.0) >= -kRounding);
  }
  SECTION("the motors switch late from a force to zero") {
    Doubted hand(0.8 * kT, 0.5 * kT);
    hand.settle();
    const double before = hand.tank.energy();
    hand.tick(10.0, 0.5 * kT, 0.0, 0.0, 0.0);
    // Switching from 10 N to zero must cost exactly this energy.
    CHECK(hand.tank.energy() ==
          Approx(before - 0.5 * kT * 100.0 / (4.0 * Doubted::kViscous)).epsilon(1e-9));
    hand.tick(0.0, 0.5 * kT, 100.0, 0.0);
    CHECK(hand.spare(0.0) >= -kRounding);
  }
  SECTION("an old force continues while the motors give zero force") {
    Doubted hand(2.0 * kT, 0.5 * kT);
    hand.settle();
    hand.tick(10.0, 0.5 * kT, 0.0, 0.0, 0.0);
    hand.tick(0.0, 0.5 * kT, 0.0, 1.0);
    hand.tick(0.0, 0.5 * kT, 0.0, 1.0);
    CHECK(hand.spare(0.0) >= -kRounding);
  }
}

TEST_CASE("the energy tank assumes the worst case of the jitter of position readings",
          "[passivity]") {
  const double period = 1e-3;
  TankParams params = acting(0.5);
  params.arm.delay = 1.25e-3;
  params.arm.doubt = params.arm.jitter = 0.25e-3;
  // In the first case, no force acts. The time between two readings can be 1.5 periods, so a hand
  // at constant speed can move 1.5 times as far.
  Tank tank;
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, period, params, kCap);
  const double speed = 0.2;
  const double longest = period + 2.0 * params.arm.jitter;
  (void)tank.pass(Vec3::Zero(), {speed * longest, 0, 0}, true, period, params, kCap);
  CHECK(tank.energy() <= 0.5 * speed * speed * longest + 1e-15);
  CHECK(tank.energy() > 0.99 * 0.5 * speed * speed * longest);
  // In the second case, a force acts. The reported position stays the same, but the force may have
  // moved the hand since the position was read.
  Tank other;
  (void)other.pass(Vec3::Zero(), Vec3::Zero(), true, period, params, 100.0);
  other.refill(10.0);
  for (int i = 1; i <= 1100; ++i) {
    (void)other.pass({std::min(10.0, 0.01 * i), 0, 0}, Vec3::Zero(), true, period, params, 100.0);
  }
  CHECK(other.energy() <= 10.0 - params.arm.jitter * 100.0 / (4.0 * 0.5));
  CHECK(other.energy() > 9.9);
}

TEST_CASE("the energy that the tank reserves for a force covers the delay's uncertainty",
          "[passivity]") {
  TankParams params = acting(0.5);
  params.arm.delay = 1e-3;
  for (const double doubt : {0.0, 2e-4}) {
    params.arm.doubt = doubt;
    Tank tank;
    (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, 1e-3, params, kCap);
    tank.refill(0.1);
    const double r = 1000.0 * tank.pass({1000, 0, 0}, Vec3::Zero(), true, 1e-3, params, kCap);
    CHECK(r * r * (1e-3 + 2.0 * doubt) / (4.0 * 0.5) == Approx(0.1).epsilon(1e-6));
  }
}

TEST_CASE(
    "motors that give less force than ordered give no energy if the energy tank knows their share",
    "[passivity]") {
  for (const bool adversary : {false, true}) {
    const auto weak = [&](PassivityRun& run) {
      run.weak = 0.3;
      run.adversary = adversary;
      if (run.seed % 2 == 0) run.doubt = std::min(run.delay, 0.3 * run.period);
      run.seconds = 1.0;
    };
    const Many told = playMany(test::cases(120), Keeper::kTank, weak);
    INFO("adversary " << adversary << ": worst " << told.worst << " J, margin [J] " << told.margin);
    CHECK(told.broken == 0);
    CHECK(told.debt == 0.0);
  }
  // A tank that does not know the motors' share credits too much work to a hand that moves against
  // the force. An adversary moves with the force, so these runs have no adversary.
  const Many untold = playMany(120, Keeper::kTank, [](PassivityRun& run) {
    run.weak = 0.3;
    run.tells_weak = false;
    run.seconds = 1.0;
  });
  INFO("share not told: " << untold.active << " runs give energy, worst " << untold.worst << " J");
  CHECK(untold.broken > 0);
}

TEST_CASE("early ticks give the hand no energy, and late ticks put the energy tank into debt",
          "[passivity]") {
  for (const bool adversary : {false, true}) {
    const auto early = [&](PassivityRun& run) {
      run.adversary = adversary;
      run.jitter = 0.9;
      run.delay = 0.0;
      run.seconds = 0.5;
    };
    const Many tank = playMany(test::cases(120), Keeper::kTank, early);
    INFO("margin [J] " << tank.margin);
    CHECK(tank.broken == 0);
    CHECK(tank.debt == 0.0);
    const auto late = [&](PassivityRun& run) {
      early(run);
      run.late = 0.05;
    };
    const Many debtors = playMany(test::cases(120), Keeper::kTank, late);
    INFO("late: margin [J] " << debtors.margin << ", debt [J] " << debtors.debt);
    CHECK(debtors.broken == 0);
    CHECK(debtors.debt > 0.0);
    // The hand extracts energy in less than a tenth of the runs, and at most 1.5 J.
    CHECK(10 * debtors.active < debtors.runs);
    CHECK(debtors.worst > -1.5);
    // With early ticks and a delay, the tank has no debt.
    const auto delayed = [&](PassivityRun& run) {
      early(run);
      run.jitter = 0.3;
      run.delay = 1.5 * run.period;
    };
    const Many between = playMany(test::cases(120), Keeper::kTank, delayed);
    INFO("delayed: margin [J] " << between.margin << ", debt [J] " << between.debt);
    CHECK(between.broken == 0);
    CHECK(between.debt == 0.0);
  }
}

TEST_CASE("a passive wall is felt unchanged, to 0.1 %, with the energy tank, an active wall is not",
          "[passivity]") {
  struct Felt {
    double scaled = 0.0;
    double lost = 0.0;
    bool kept = true;
  };
  // A hand with damping of only 0.01 N s/m keeps most of the energy that it gets from the wall.
  const auto feel = [](double of_passive) {
    Felt felt;
    const long count = test::cases(40);
    for (long i = 0; i < count; ++i) {
      PassivityRun run = bench::randomRun(static_cast<std::uint64_t>(i), true);
      run.scene = bench::ActiveScene::kWall;
      run.damping = 0.0;
      run.grip = 300.0;
      run.grip_damping = 0.01;
      run.coulomb = 1e-4;
      run.known_viscous = run.known_coulomb = 1.0;
      run.encoder = 1e-7;
      run.viscous = std::max(run.viscous, 0.5);
      run.stiffness = of_passive * run.viscous / (0.5 * run.period + run.delay);
      const PassivityResult r = bench::play(run, Keeper::kTank);
      felt.kept = felt.kept && r.margin > -1e-12;
      felt.scaled += r.scaled / static_cast<double>(count);
      felt.lost += r.lost / static_cast<double>(count);
    }
    return felt;
  };
  const Felt passive = feel(0.6);
  const Felt active = feel(3.0);
  CAPTURE(passive.scaled, passive.lost, active.scaled, active.lost);
  CHECK(passive.kept);
  CHECK(passive.scaled < 1e-3);
  CHECK(passive.lost < 1e-3);
  CHECK(active.kept);
  CHECK(active.scaled > 0.01);
  CHECK(active.lost > 0.01);
}

TEST_CASE("without encoder steps or delay the tank allows a force up to the closed-form limit",
          "[passivity]") {
  // A hand that moves by dx = 1 mm in a period T against viscous friction b puts in b dx^2 / T. A
  // force R that acts for a period T can extract at most R^2 T / (4 b).
  const double b = 0.5;
  const double period = 1e-3;
  Tank tank;
  const TankParams params = acting(b);
  CHECK(tank.pass({1, 0, 0}, Vec3::Zero(), true, period, params, kCap) == 0.0);
  CHECK(tank.pass(Vec3::Zero(), {1e-3, 0, 0}, true, period, params, kCap) == 1.0);
  const double paid = b * 1e-6 / period;
  CHECK(tank.energy() == Approx(paid));
  const double most = std::sqrt(4.0 * b * paid / period);
  const double share = tank.pass({0, 10.0 * most, 0}, {1e-3, 0, 0}, true, period, params, kCap);
  CHECK(share == Approx(0.1).epsilon(1e-6));
  // The hand moves at the speed that gains most against b. Then the tank is empty, without debt.
  const Vec3 way(1e-3, share * 10.0 * most * period / (2.0 * b), 0);
  CHECK(tank.pass({0, 1, 0}, way, true, period, params, kCap) == Approx(0.0).margin(1e-3));
  CHECK(tank.energy() == Approx(0.0).margin(1e-11));
  CHECK(tank.debt() == 0.0);
}

TEST_CASE("the energy tank pays for the uncertainty of an encoder step while a force acts",
          "[passivity]") {
  // The tank knows a path only to within an encoder step. So a force costs half a step times the
  // force when it starts to act. While it acts, it costs the same amount again.
  const double b = 0.5;
  const double period = 1e-3;
  const double step = 1e-5;
  Tank tank;
  const TankParams params = acting(b, 0.0, step);
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, period, params, kCap);
  (void)tank.pass(Vec3::Zero(), {1e-3, 0, 0}, true, period, params, kCap);
  const double surely = 1e-3 - step;
  const double paid = b / period * surely * surely;
  CHECK(tank.energy() == Approx(paid));
  const double r = 100.0 * tank.pass({100, 0, 0}, {1e-3, 0, 0}, true, period, params, kCap);
  CHECK(r * r * period / (4.0 * b) == Approx(paid).epsilon(1e-6));
  // The hand rests, so the tank subtracts only that cost.
  (void)tank.pass(Vec3::Zero(), {1e-3, 0, 0}, true, period, params, kCap);
  CHECK(tank.energy() == Approx(std::max(0.0, paid - step * r)).epsilon(1e-6));
  // A path against Coulomb friction counts with the factor cos(30 degrees).
  Tank rubbed;
  const TankParams rubs = acting(b, 0.2, step);
  (void)rubbed.pass(Vec3::Zero(), Vec3::Zero(), true, period, rubs, kCap);
  (void)rubbed.pass(Vec3::Zero(), {1e-3, 0, 0}, true, period, rubs, kCap);
  CHECK(rubbed.energy() == Approx(paid + 0.5 * std::sqrt(3.0) * 0.2 * surely));
}

TEST_CASE(
    "a force that varies between two position readings costs the tank the energy the hand can gain",
    "[passivity]") {
  const double b = 0.5;
  const double period = 1e-3;
  const TankParams params = acting(b);
  Tank tank;
  const Vec3 at(1e-3, 0, 0);
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, period, params, kCap);
  (void)tank.pass(Vec3::Zero(), at, true, period, params, kCap);
  const double paid = tank.energy();
  const double force = std::sqrt(2.0 * b * paid / period);
  CHECK(tank.pass({force, 0, 0}, at, true, period, params, kCap) == 1.0);
  (void)tank.pass(Vec3::Zero(), at, false, period, params, kCap);
  (void)tank.pass(Vec3::Zero(), at, true, period, params, kCap);
  // The force is on and off in alternate ticks, so half of its square varies about the mean.
  const double varies = 0.5 * force * force * period;
  CHECK(tank.energy() == Approx(paid - varies / (4.0 * b)));
}

TEST_CASE("the tank stores a hand's work up to its cap and gives it back", "[passivity]") {
  const double b = 0.5;
  const double period = 1e-3;
  const double cap = 0.01;
  const TankParams params = acting(b);
  Tank tank;
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, period, params, cap);
  (void)tank.pass(Vec3::Zero(), {1e-2, 0, 0}, true, period, params, cap);  // 50 mJ
  CHECK(tank.energy() == Approx(cap));
  // The hand moves with the force and extracts 0.5 mJ per tick, the largest possible amount.
  for (int i = 0; i <= 10; ++i) {
    CHECK(tank.pass({1, 0, 0}, {1e-2 + 1e-3 * i, 0, 0}, true, period, params, cap) == 1.0);
  }
  CHECK(tank.energy() == Approx(cap - 10 * 0.5e-3));
}

TEST_CASE("encoder steps never make the tank overestimate the hand's work against Coulomb friction",
          "[passivity]") {
  std::mt19937_64 random(5);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  const double c = 0.3;
  for (int walk = 0; walk < 200; ++walk) {
    const double encoder = std::pow(10.0, -6.0 + 2.0 * std::abs(unit(random)));
    Tank tank;
    TankParams params = acting(1e-12, c, std::sqrt(3.0) * encoder);
    Vec3 x = 1e-3 * Vec3(unit(random), unit(random), unit(random));
    double path = 0.0;
    Vec3 going = Vec3::Zero();
    for (int i = 0; i < 2000; ++i) {
      going = 0.9 * going + encoder * Vec3(unit(random), unit(random), unit(random));
      x += going;
      path += going.norm();
      const Vec3 read = (x / encoder).array().round().matrix() * encoder;
      (void)tank.pass(Vec3::Zero(), read, true, 1e-3, params, 1e9);
      // The viscous friction of 1e-12 N s/m adds a negligible amount.
      REQUIRE(tank.energy() <= c * path + 1e-13);
    }
    CHECK(tank.energy() > 0.3 * c * path);
  }
}

TEST_CASE("the energy tank gives no force to an arm of unknown friction", "[passivity]") {
  Tank tank;
  CHECK(tank.pass({1, 0, 0}, Vec3::Zero(), true, 1e-3, acting(0.0), kCap) == 0.0);
  CHECK(tank.pass({1, 0, 0}, Vec3::Zero(), true, 1e-3, acting(-1.0), kCap) == 0.0);
  CHECK(tank.pass({1, 0, 0}, Vec3::Zero(), true, 1e-3, acting(std::nan("")), kCap) == 0.0);
  TankParams off;
  CHECK(tank.pass({1, 0, 0}, Vec3::Zero(), true, 1e-3, off, kCap) == 1.0);
}

TEST_CASE("an invalid position of the hand empties the energy tank", "[passivity]") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  Tank tank;
  const TankParams params = acting(0.5);
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, 1e-3, params, kCap);
  (void)tank.pass(Vec3::Zero(), {1e-2, 0, 0}, true, 1e-3, params, kCap);
  CHECK(tank.energy() > 0.0);
  CHECK(tank.pass({1, 0, 0}, {nan, 0, 0}, true, 1e-3, params, kCap) == 0.0);
  CHECK(tank.energy() == 0.0);
  // After an invalid position, the tank starts again at the hand's position in the next call. The
  // path to that position does not count.
  CHECK(tank.pass({1, 0, 0}, {1, 1, 0}, true, 1e-3, params, kCap) == 0.0);
  CHECK(tank.pass({1, 0, 0}, {1, 1, 1}, true, 1e-3, params, kCap) == 0.0);
  CHECK(tank.pass(Vec3::Zero(), {1, 1, 1.001}, true, 1e-3, params, kCap) == 1.0);
  CHECK(tank.energy() == Approx(0.5e-3));
  // A tick with an invalid period must leave the energy unchanged.
  const double before = tank.energy();
  for (const double dt : {0.0, -1.0, nan, 1e-310}) {
    (void)tank.pass(Vec3::Zero(), {1, 1, 1.002}, true, dt, params, kCap);
    CHECK(tank.energy() == before);
  }
}

TEST_CASE("the hand's work fills the energy tank only to its cap but a refill may exceed the cap",
          "[passivity]") {
  Tank tank;
  const TankParams params = acting(0.5);
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, 1e-3, params, 0.01);
  (void)tank.pass(Vec3::Zero(), {1, 0, 0}, true, 1e-3, params, 0.01);
  CHECK(tank.energy() == 0.01);
  tank.refill(0.02);
  CHECK(tank.energy() == Approx(0.03));
  CHECK(tank.refilled() == 0.02);
}

TEST_CASE("the energy tank restarts if more delayed forces are pending than it can store",
          "[passivity]") {
  Tank tank;
  TankParams params = acting(5.0);
  params.arm.delay = 0.2;
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, 1e-3, params, kCap);
  tank.refill(1.0);
  int granted = 0;
  for (int i = 0; i < 100; ++i) {
    granted += tank.pass({1, 0, 0}, Vec3::Zero(), true, 1e-3, params, kCap) == 1.0 ? 1 : 0;
  }
  CHECK(granted == static_cast<int>(Tank::kForces) - 2);
  CHECK(tank.energy() == 0.0);
  CHECK(tank.debt() == 0.0);
}

TEST_CASE(
    "an energy tank that restarts in a late tick gives no force until the old forces have ended",
    "[passivity]") {
  TankParams params = acting(0.5);
  params.arm.delay = 3e-3;
  Tank tank;
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, 1e-3, params, kCap);
  tank.refill(0.06);
  for (int i = 0; i < 5; ++i) (void)tank.pass({4, 0, 0}, Vec3::Zero(), true, 1e-3, params, kCap);
  // The 4 N sent before the reset still act for 3 ms.
  tank.forget();
  CHECK(tank.pass({4, 0, 0}, Vec3::Zero(), true, 5e-3, params, kCap) == 0.0);
  Vec3 hand = Vec3::Zero();
  for (int i = 0; i < 3; ++i) {
    hand.x() += 8e-3;
    CHECK(tank.pass({4, 0, 0}, hand, true, 1e-3, params, kCap) == 0.0);
    CHECK(tank.energy() == 0.0);
  }
}

TEST_CASE("refilling the energy tank beyond its cap causes no debt later", "[passivity]") {
  TankParams params = acting(0.5);
  params.arm.delay = 2e-3;
  Tank tank;
  const double cap = 0.01;
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, 1e-3, params, cap);
  tank.refill(cap);
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, 1e-3, params, cap);
  tank.refill(cap);
  (void)tank.pass({100, 0, 0}, Vec3::Zero(), false, 1e-3, params, cap);
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, 1e-3, params, cap);
  CHECK(tank.debt() == 0.0);
}

TEST_CASE("a hand gains no energy if its positions repeat for several ticks", "[passivity]") {
  // The arm reports a position only in every n-th tick, so the hand took n ticks for the path
  // between two positions.
  for (const bool adversary : {false, true}) {
    for (const int every : {1, 2, 4}) {
      const Many tank = playMany(test::cases(100), Keeper::kTank, [&](PassivityRun& run) {
        run.adversary = adversary;
        run.every = every;
        run.seconds = 0.5;
      });
      INFO("every " << every << ": margin [J] " << tank.margin << ", debt [J] " << tank.debt);
      CHECK(tank.broken == 0);
      CHECK(tank.debt == 0.0);
    }
  }
  // As a control, the loop passes repeated positions as new ones. Then some hands gain energy.
  const Many told = playMany(test::cases(100), Keeper::kTank, [](PassivityRun& run) {
    run.every = 4;
    run.tells_age = false;
    run.seconds = 0.5;
  });
  CHECK(told.broken > 0);
}

TEST_CASE("a restarted energy tank counts a hand's work only from the first new position on",
          "[passivity]") {
  // The hand moved a part of the path to the next position before the reset. So the tank must not
  // count this path.
  const TankParams params = acting(0.5);
  Tank tank;
  for (int n = 0; n < 3; ++n) {
    tank.forget();
    CHECK(tank.pass({1, 0, 0}, Vec3::Zero(), false, 1e-3, params, kCap) == 0.0);
    CHECK(tank.pass({1, 0, 0}, {8e-3, 0, 0}, true, 1e-3, params, kCap) == 0.0);
    CHECK(tank.energy() == 0.0);
    CHECK(tank.pass({0, 0, 0}, {9e-3, 0, 0}, true, 1e-3, params, kCap) == 1.0);
    CHECK(tank.energy() == Approx(0.5 * 1e-6 / 1e-3));
  }
  // A new tank must behave in the same way.
  Tank other;
  (void)other.pass(Vec3::Zero(), Vec3::Zero(), false, 1e-3, params, kCap);
  (void)other.pass(Vec3::Zero(), {8e-3, 0, 0}, true, 1e-3, params, kCap);
  CHECK(other.energy() == 0.0);
}

TEST_CASE("no hand extracts energy from an energy tank that restarts often", "[passivity]") {
  for (const bool adversary : {false, true}) {
    const auto forgetful = [&](PassivityRun& run) {
      run.adversary = adversary;
      run.seconds = 0.5;
      if (run.seed % 3 == 1) bench::doubtDelay(run);
      if (run.seed % 5 == 1) bench::shakeReadings(run);
      if (run.seed % 7 == 1) bench::letLag(run);
      bench::forgetOften(run);
      // forgetOften uses the lowest five bits of the seed.
      run.jitter = run.seed / 32 % 4 == 0 ? 0.5 : 0.0;
    };
    const Many tank = playMany(test::cases(400), Keeper::kTank, forgetful);
    INFO("adversary " << adversary << ": margin [J] " << tank.margin);
    CHECK(tank.broken == 0);
    CHECK(tank.debt == 0.0);
  }
  for (const bool at_once : {false, true}) {
    Many searched;
    const long searches = test::cases(4);
    for (long i = 0; i < searches; ++i) {
      searched.add(bench::playSearched(static_cast<std::uint64_t>(i), 300, at_once));
    }
    INFO("searched, at once " << at_once << ": margin [J] " << searched.margin);
    CHECK(searched.broken == 0);
  }
}

TEST_CASE("invalid numbers and impossible positions add no energy to the tank", "[passivity]") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const TankParams params = acting(0.5, 0.02, 1e-5);
  Tank tank;
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, 1e-3, params, kCap);
  for (const double far : {1.7e308, -1.7e308, 1e7}) {
    CHECK(tank.pass({1, 0, 0}, {far, 0, 0}, true, 1e-3, params, kCap) == 0.0);
    CHECK(tank.energy() == 0.0);
  }
  for (const double bad : {nan, -1.0, std::numeric_limits<double>::infinity()}) {
    tank.refill(bad);
    CHECK(tank.energy() == 0.0);
    CHECK(tank.refilled() == 0.0);
  }
  // Neither a huge force nor a NaN lag may fill the tank.
  tank.refill(0.1);
  CHECK(tank.pass({1e200, 0, 0}, Vec3::Zero(), true, 1e-3, params, kCap) < 1e-100);
  CHECK(tank.energy() <= 0.1);
  TankParams rubbish = params;
  rubbish.arm.lag = nan;
  for (int i = 0; i < 3; ++i) {
    CHECK(tank.pass({1, 0, 0}, Vec3::Zero(), true, 1e-3, rubbish, kCap) == 0.0);
    CHECK(tank.energy() == 0.0);
  }
  CHECK(tank.pass({1, 0, 0}, Vec3::Zero(), true, 1e-3, params, kCap) == 0.0);
}

TEST_CASE("a restarted energy tank gives no force while an older force is under way",
          "[passivity]") {
  TankParams params = acting(0.5);
  params.arm.delay = 3e-3;
  Tank tank;
  (void)tank.pass(Vec3::Zero(), Vec3::Zero(), true, 1e-3, params, kCap);
  tank.refill(0.5);
  CHECK(tank.pass({1, 0, 0}, Vec3::Zero(), true, 1e-3, params, kCap) == 1.0);
  tank.forget();
  // For the delay plus one period after a reset, the tank credits no energy for the hand's motion.
  Vec3 hand = Vec3::Zero();
  for (int i = 0; i < 4; ++i) {
    hand.x() += 1e-3;
    CHECK(tank.pass({1, 0, 0}, hand, true, 1e-3, params, kCap) == 0.0);
    CHECK(tank.energy() == 0.0);
  }
  hand.x() += 1e-3;
  CHECK(tank.pass({0.1, 0, 0}, hand, true, 1e-3, params, kCap) > 0.0);
}

}  // namespace palpate::passivity_test
