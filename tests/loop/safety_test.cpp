/// Tests the limits on a hand's motion, the brake on a fast hand, and the fade of a force after a
/// change of the data.
#include "palpate/engine/safety/safety.h"

#include <cmath>
#include <cstring>
#include <limits>
#include <set>
#include <string>

#include <catch2/catch.hpp>

#include "tests/support/random.h"

namespace palpate::safety_test {
using palpate::test::Random;

namespace {

HandState at(const Vec3& p, double age = 0.0) {
  HandState hand;
  hand.position = p;
  hand.age = age;
  return hand;
}

}  // namespace

TEST_CASE("every fault has its own word, and a description and a remedy", "[safety]") {
  std::set<std::string> words;
  for (std::size_t i = 1; i < kFaults; ++i) {
    const auto fault = static_cast<Fault>(i);
    CHECK(words.insert(wordFor(fault)).second);
    CHECK(std::strlen(wordsFor(fault)) > 8);
    CHECK(std::strlen(remedyFor(fault)) > 7);
  }
  CHECK(std::string(wordFor(Fault::kStopped)) == "stopped");
}

TEST_CASE("a repeated position is not stale but an old position is", "[safety]") {
  // In a loop of 10 kHz, an arm of 1 kHz reports each position ten times.
  HandWatch watch;
  Random random(2);
  Vec3 p = Vec3::Zero();
  for (int i = 0; i < 20000; ++i) {
    if (i % 10 == 0) p += 1e-3 * random.inCube(0.5);  // up to 0.9 m/s
    HandState hand = at(p, 1e-4 * (i % 10));
    REQUIRE(watch.look(hand, 1e-4 * i) == Fault::kNone);
  }
  HandState old = at(p, 0.049);
  CHECK(watch.look(old, 2.05) == Fault::kNone);
  old.age = 0.051;
  CHECK(watch.look(old, 2.06) == Fault::kStale);
}

TEST_CASE("a position step faster than any hand is a jump fault", "[safety]") {
  for (const double rate : {500.0, 1000.0, 20000.0}) {
    for (const double speed : {0.5, 2.9, 4.9}) {
      // The hand does not jump, even if it is faster than the device's speed limit for a short
      // time.
      HandWatch watch;
      Fault worst = Fault::kNone;
      for (int i = 0; i < 20; ++i) {
        HandState hand = at({speed * i / rate, 0, 0});
        const Fault fault = watch.look(hand, i / rate);
        if (fault != Fault::kNone) worst = fault;
      }
      CAPTURE(rate, speed);
      CHECK(worst == Fault::kNone);
    }
    HandWatch watch;
    HandState hand = at(Vec3::Zero());
    CHECK(watch.look(hand, 0.0) == Fault::kNone);
    hand = at({0, 0, std::max(1.1e-3, 5.1 / rate)});
    CHECK(watch.look(hand, 1.0 / rate) == Fault::kJump);
    // After forget(), no position counts as a jump.
    watch.forget();
    hand = at({9, 9, 9});
    CHECK(watch.look(hand, 5.0) == Fault::kNone);
  }
}

TEST_CASE("a hand above the speed limit is braked first and is a fault 50 ms later", "[safety]") {
  HandWatch watch;
  double braked = -1.0;
  double cut = -1.0;
  for (int i = 0; i < 300 && cut < 0.0; ++i) {
    HandState hand = at({0, 3.5e-3 * i, 0});
    const Fault fault = watch.look(hand, 1e-3 * i);
    if (hand.too_fast && braked < 0.0) braked = 1e-3 * i;
    if (fault == Fault::kOverSpeed) cut = 1e-3 * i;
    REQUIRE((fault == Fault::kNone || fault == Fault::kOverSpeed));
    if (hand.too_fast) CHECK(hand.velocity.y() == Approx(3.5).epsilon(0.15));
  }
  CHECK(braked > 0.0);
  CHECK(braked < 0.02);
  CHECK(cut == Approx(braked + 0.05).margin(2e-3));
  // A hand that slows down in time causes no fault.
  watch.forget();
  for (int i = 0; i < 300; ++i) {
    const double y = i < 40 ? 3.5e-3 * i : 3.5e-3 * 40 + 1e-3 * (i - 40);
    HandState hand = at({0, y, 0});
    REQUIRE(watch.look(hand, 10.0 + 1e-3 * i) == Fault::kNone);
  }
}

TEST_CASE("the braking force on a fast hand only takes energy from the hand", "[safety]") {
  Random random(4);
  for (long i = 0; i < test::cases(100000); ++i) {
    const Vec3 force = random.inCube(10.0);
    const Vec3 velocity = random.inCube(6.0);
    const Vec3 braked = brake(force, velocity, 3.0);
    if (velocity.norm() <= 3.0) {
      REQUIRE(braked == force);
    } else {
      const double power = braked.dot(velocity);
      REQUIRE(power <= std::min(0.0, force.dot(velocity)) + 1e-12);
      // The force perpendicular to the motion must not change.
      const Vec3 ahead = velocity.normalized();
      REQUIRE((braked - ahead.dot(braked) * ahead - (force - ahead.dot(force) * ahead)).norm() <
              1e-12);
    }
  }
}

TEST_CASE("any position from a device gives a fault or a finite velocity", "[safety]") {
  Random random(6);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  HandWatch watch;
  for (long i = 0; i < test::cases(200000); ++i) {
    const auto any = [&] {
      const int n = random.integer(40);
      return n == 0 ? nan : n == 1 ? INFINITY : n == 2 ? 1e300 : random.uniform(-2e-3, 2e-3);
    };
    HandState hand = at({any(), any(), any()}, random.integer(10) == 0 ? any() : 0.0);
    const Fault fault = watch.look(hand, 1e-3 * static_cast<double>(i));
    if (fault == Fault::kNone) REQUIRE(hand.velocity.allFinite());
    if (!hand.position.allFinite()) REQUIRE(fault != Fault::kNone);
    if (fault != Fault::kNone) watch.forget();
  }
}

TEST_CASE("a force fades to zero within 100 ms if a data change removes its cause at once",
          "[safety]") {
  DataFade fade;
  const Vec3 pull(0.0, 3.0, 0.0);
  const Vec3 none = Vec3::Zero();
  constexpr double kTick = 1e-3;  // [s]
  constexpr double kStep = 2.0;   // [N] per tick
  constexpr double kStand = std::numeric_limits<double>::infinity();
  // If the hand itself leaves, or the change is below the limit, the force changes at once.
  CHECK(fade.pass(pull, kStand, none, kTick) == pull);
  CHECK(fade.pass(none, kStand, none, kTick) == none);
  CHECK(fade.pass(0.5 * pull, kStep, none, kTick) == 0.5 * pull);
  CHECK(fade.pass(none, kStep, none, kTick) == none);
  // If a surface vanishes, the force falls to zero in the same time at both tick rates.
  for (const double tick : {1e-3, 2.5e-4}) {
    (void)fade.pass(pull, kStand, none, tick);
    double last = 3.0;
    double most = 0.0;
    for (double t = tick; t < 0.05 + 0.5 * tick; t += tick) {
      const double out = fade.pass(none, kStep, none, tick).y();
      most = std::max(most, last - out);
      last = out;
    }
    CHECK(last == Approx(3.0 * std::pow(0.5, 5.0)).margin(0.02));
    CHECK(most < 0.06 * 3.0 * tick / 1e-3);
    for (double t = 0.0; t < 0.05 + tick; t += tick) last = fade.pass(none, kStep, none, tick).y();
    CHECK(last == 0.0);
  }
  // For random wanted forces up to 8 N in one direction, the output stays between 0 and 8 N.
  Random random(5);
  double wanted = 0.0;
  for (int i = 0; i < 20000; ++i) {
    const double up = i % 2000 < 1000 ? 3.0 : 0.7;
    wanted += wanted > 5.0 ? -5.0 * random.uniform() : up * random.uniform();
    wanted = std::max(wanted, 0.0);
    const double out = fade.pass({0.0, wanted, 0.0}, kStep, none, kTick).y();
    REQUIRE(out >= 0.0);
    REQUIRE(out <= 8.0);
  }
  // After forget(), or in a tick of zero duration, the force changes at once.
  (void)fade.pass(pull, kStand, none, kTick);
  fade.forget();
  CHECK(fade.pass(none, kStep, none, kTick) == none);
  (void)fade.pass(pull, kStand, none, kTick);
  CHECK(fade.pass(none, kStep, none, 0.0) == none);
  (void)fade.pass(Vec3::Constant(std::nan("")), kStep, none, kTick);
  fade.forget();
  CHECK(fade.pass(pull, kStep, none, kTick) == pull);
}

TEST_CASE("the fading force of a vanished surface does at most the work of the stretched spring",
          "[safety]") {
  constexpr double kTick = 1e-3;        // [s]
  constexpr double kStiffness = 500.0;  // [N/m]
  const Vec3 none = Vec3::Zero();
  const Vec3 pull(0.0, 5.0, 0.0);
  const double spring = pull.squaredNorm() / (2.0 * kStiffness);  // 25 mJ
  // The hand moves with the force, either at constant speed or as a mass that the force
  // accelerates.
  for (const double mass : {0.0, 0.02, 0.2, 2.0}) {
    for (double speed : {0.0, 0.1, 0.5, 2.0}) {
      if (mass == 0.0 && speed == 0.0) continue;
      CAPTURE(mass, speed);
      DataFade fade;
      (void)fade.pass(pull, 1e9, none, kTick);
      double work = 0.0;
      double step = 0.0;
      Vec3 way = none;
      for (int i = 0; i < 200; ++i) {
        const Vec3 out = fade.pass(none, 1.0, kStiffness * way, kTick);
        REQUIRE(out.y() >= 0.0);
        if (mass > 0.0) speed += out.y() / mass * kTick;
        way = Vec3(0.0, speed * kTick, 0.0);
        work += out.dot(way);
        step = std::max(step, way.y());
      }
      // The sampled force lags by one tick, which adds up to half a step's work.
      CHECK(work <= spring + 0.5 * pull.y() * step);
    }
  }
  // Motion against the force or perpendicular to it must not shorten the fade.
  DataFade with;
  DataFade without;
  for (DataFade* fade : {&with, &without}) (void)fade->pass(pull, 1e9, none, kTick);
  for (int i = 0; i < 50; ++i) {
    const Vec3 out = with.pass(none, 1.0, {3.0, -1.0, 2.0}, kTick);
    CHECK(out == without.pass(none, 1.0, none, kTick));
  }
}

}  // namespace palpate::safety_test
