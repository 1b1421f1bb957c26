/// Tests the play clock: pause, speed, reverse, seek, repeat.
#include "palpate/engine/loop/play_clock.h"

#include <cmath>
#include <limits>

#include <catch2/catch.hpp>

#include "palpate/engine/loop/hand_tick.h"
#include "palpate/engine/loop/haptic_loop.h"
#include "tests/support/scenes.h"

namespace palpate::play_clock_test {
using namespace palpate::test;

namespace {

constexpr double kTick = 1e-3;

double after(const PlayClock& clock, PlayHead& head, int ticks) {
  double play = head.time;
  for (int i = 0; i < ticks; ++i) play = clock.next(head, kTick);
  return play;
}

}  // namespace

TEST_CASE("play time advances with the ticks and follows pause, speed, seek and repeat",
          "[sequence]") {
  PlayClock clock({1.0, false, 2.0, 5.0, false});
  PlayHead head;
  CHECK(clock.next(head, kTick) == 2.0);  // the first tick starts play
  CHECK(after(clock, head, 500) == Approx(2.5));
  CHECK(head.rate == Approx(1.0));
  clock.pause(true);
  CHECK(after(clock, head, 500) == Approx(2.5));
  CHECK(head.rate == 0.0);
  clock.nudge(0.25);
  clock.nudge(0.25);
  CHECK(after(clock, head, 1) == Approx(3.0));
  clock.pause(false);
  clock.setSpeed(-2.0);
  CHECK(after(clock, head, 250) == Approx(2.5));
  CHECK(head.rate == Approx(-2.0));
  CHECK(after(clock, head, 1000) == 2.0);  // stops at the start of the range
  CHECK(head.rate == 0.0);
  clock.setSpeed(1.0);
  clock.seek(4.9);
  CHECK(after(clock, head, 1) == 4.9);
  CHECK(after(clock, head, 1000) == 5.0);  // stops at the end of the range
  clock.repeat(true);
  CHECK(after(clock, head, 500) == Approx(2.5));
  clock.setSpeed(-1.0);
  CHECK(after(clock, head, 1000) == Approx(4.5));
}

TEST_CASE("the play clock reports the last tick's position and the nudges since then",
          "[sequence]") {
  PlayClock clock({1.0, false, 2.0, 5.0, false, 2.5});
  PlayHead head;
  CHECK(clock.position() == 2.5);
  CHECK(after(clock, head, 501) == Approx(3.0));
  CHECK(clock.position() == head.time);
  clock.pause(true);
  clock.nudge(0.25);
  CHECK(clock.position() == Approx(3.25));
  CHECK(after(clock, head, 1) == Approx(3.25));
  CHECK(clock.position() == Approx(3.25));
  clock.seek(4.0);
  CHECK(after(clock, head, 1) == 4.0);
  CHECK(clock.position() == Approx(4.0));
}

TEST_CASE("play stops at the new end if the end moves before the play time", "[sequence]") {
  PlayClock clock({1.0, false, 0.0, 3.0, false});
  PlayHead head;
  CHECK(after(clock, head, 2001) == Approx(2.0));
  clock.steer({1.0, false, 0.0, 0.5, false});
  CHECK(clock.next(head, kTick) == 0.5);
  CHECK(head.rate == 0.0);
  clock.steer({-1.0, false, 0.25, 0.5, false});
  CHECK(after(clock, head, 100) == Approx(0.4));
  CHECK(head.rate == Approx(-1.0));
}

TEST_CASE("play time stays finite for invalid seeks, speeds and ends", "[sequence]") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double infinity = std::numeric_limits<double>::infinity();
  PlayClock clock;
  PlayHead head;
  (void)clock.next(head, kTick);
  for (const double bad : {nan, infinity, -infinity}) {
    clock.seek(bad);
    clock.nudge(bad);
    clock.setSpeed(bad);
    CHECK(std::isfinite(clock.next(head, bad)));
    clock.steer({1.0, false, 0.0, bad, true});
    CHECK(std::isfinite(clock.next(head, kTick)));
    clock.steer({1.0, false, bad, infinity, false});
    CHECK(std::isfinite(clock.next(head, kTick)));
    clock.steer({});
    CHECK(std::isfinite(clock.next(head, kTick)));
  }
  clock.setSpeed(1e308);
  CHECK(std::isfinite(after(clock, head, 10)));
  CHECK(std::isfinite(after(clock, head, 10000)));
}

TEST_CASE("two loops with one play clock have the same play time in each tick", "[sequence]") {
  PlayClock clock({1.0, false, 0.0, 3.0, true});
  TestDevice first;
  TestDevice second;
  HapticLoop one(first, 1000.0);
  HapticLoop two(second, 1000.0);
  HapticLoop alone(second, 1000.0);
  one.playBy(&clock);
  two.playBy(&clock);
  for (int i = 0; i < 2500; ++i) {
    if (i == 1000) clock.seek(2.0);
    if (i == 1500) clock.pause(true);
    const TickTime time{kTick * i, kTick, 0.0, false, 0, false};
    one.tick(time);
    two.tick(time);
    alone.tick(time);
    REQUIRE(one.latest().input.play == two.latest().input.play);
  }
  CHECK(one.latest().input.play == Approx(2.499));
  CHECK(alone.latest().input.play == 0.0);
}

}  // namespace palpate::play_clock_test
