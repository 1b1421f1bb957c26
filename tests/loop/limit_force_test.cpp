/// Tests limitForce(), which limits each force before it is sent to the arm.
#include "palpate/engine/safety/limit_force.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include <catch2/catch.hpp>

#include "tests/support/random.h"

namespace palpate::limit_force_test {
using palpate::test::Random;

namespace {

/// Limits `wanted` in the tick after the force `previous` was sent.
LimitedForce after(const Vec3& previous, const Vec3& wanted, double dt, const ForceLimits& limits) {
  LimiterState state;
  state.sent = previous;
  return limitForce(wanted, Vec3::Zero(), dt, limits, state);
}

}  // namespace

TEST_CASE("a force that is not finite or whose norm overflows becomes zero and is reported",
          "[safety]") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  for (const double bad : {nan, inf, -inf, 1.7e308}) {
    const LimitedForce out = after({1, 0, 0}, {bad, bad, 0}, 1e-3, {});
    CHECK(out.force == Vec3::Zero());
    CHECK_FALSE(out.finite);
    CHECK(out.limited());
  }
}

TEST_CASE("the peak limit scales a force and keeps its direction", "[safety]") {
  const LimitedForce out = after({0, 0, 0}, {30, 40, 0}, 1.0, {5.0, 1e6});
  CHECK(out.peaked);
  CHECK((out.force - Vec3(3, 4, 0)).norm() < 1e-11);
}

TEST_CASE("the growth of the force is slew-limited, and its release is immediate", "[safety]") {
  const ForceLimits limits{10.0, 2000.0};
  const LimitedForce grown = after({1, 0, 0}, {5, 0, 0}, 1e-3, limits);
  CHECK(grown.slewed);
  CHECK((grown.force - Vec3(3, 0, 0)).norm() < 1e-14);

  const LimitedForce released = after({9, 0, 0}, {0.5, 0, 0}, 1e-3, limits);
  CHECK_FALSE(released.limited());
  CHECK(released.force == Vec3(0.5, 0, 0));

  // If the wanted force reverses, the old force ends at once and the new force grows from zero.
  const LimitedForce turned = after({5, 0, 0}, {-5, 0, 0}, 1e-3, limits);
  CHECK((turned.force - Vec3(-2, 0, 0)).norm() < 1e-14);
}

TEST_CASE("limiting any input gives a finite force within the peak, the slew and the wanted force",
          "[safety]") {
  Random random(7);
  const auto bits = [&] {
    std::uint64_t raw = 0;
    for (int i = 0; i < 4; ++i)
      raw = (raw << 16) | static_cast<std::uint64_t>(random.integer(65536));
    double value = 0.0;
    std::memcpy(&value, &raw, sizeof value);
    return value;
  };
  const auto any = [&] { return random.integer(3) == 0 ? bits() : random.uniform(-9.0, 9.0); };
  long finite = 0;
  for (long i = 0; i < test::cases(200000); ++i) {
    const Vec3 wanted(any(), any(), any());
    const Vec3 previous(any(), any(), any());
    const double dt = random.integer(20) == 0 ? bits() : random.logUniform(1e-5, 1e-1);
    ForceLimits limits{random.logUniform(0.1, 20.0), random.logUniform(1.0, 1e5)};
    if (random.integer(2) == 0) limits.continuous = random.uniform(0.0, 1.2) * limits.peak;
    LimiterState state;
    state.sent = previous;
    state.heat = random.integer(2) == 0 ? 0.0 : random.uniform(0.0, 400.0);
    if (random.integer(3) == 0) state.engage(random.uniform(0.0, 1.0));
    if (random.integer(3) == 0) state.share = random.uniform(0.0, 1.0);
    CAPTURE(wanted, previous, dt, limits.peak, limits.slew);
    const LimitedForce out = limitForce(wanted, Vec3::Zero(), dt, limits, state);
    CHECK(state.sent == out.force);
    CHECK(std::isfinite(state.heat));
    const bool held = out.force.allFinite() && out.force.stableNorm() <= limits.peak &&
                      (!out.finite || out.force.stableNorm() <= wanted.stableNorm() * (1 + 1e-12));
    if (!held) FAIL("the force is not finite, or exceeds the peak or the wanted force");
    const double last = previous.allFinite() ? previous.stableNorm() : 0.0;
    const double growth = dt > 0 && std::isfinite(dt) ? limits.slew * dt : 0.0;
    if (out.force.stableNorm() >
        (std::isfinite(last) ? last : 0.0) * (1 + 1e-12) + growth * (1 + 1e-12)) {
      FAIL("the force grew faster than the slew limit");
    }
    finite += out.finite;
  }
  CHECK(finite > 0);
}

TEST_CASE("an engagement waits for a small force or for one second, then ramps up the force",
          "[safety]") {
  ForceLimits limits{10.0, 1e9};
  constexpr double kDt = 1e-3;
  for (const bool pressed : {false, true}) {
    LimiterState state;
    state.engage(kEngage);
    double silent = 0.0;
    double ramp = 0.0;
    double last = 0.0;
    for (int i = 0; i < 3000; ++i) {
      // The hand presses either from the start or after 0.2 s.
      const double wanted = pressed || i > 200 ? 4.0 : 0.05;
      const LimitedForce out = limitForce({0, wanted, 0}, Vec3::Zero(), kDt, limits, state);
      const double force = out.force.norm();
      CHECK(force <= wanted);
      CHECK(force >= last - (i == 201 ? 1.0 : 1e-12));
      // The force grows by at most the ramp's growth per tick. When the hand begins to press (i =
      // 201), the force may jump to the ramp's present value.
      if (i != 201) CHECK(force - last <= 4.0 * kDt / kEngage + 1e-12);
      last = force;
      if (force == 0.0) silent += kDt;
      if (force > 0.0 && force < wanted) ramp += kDt;
      CHECK(out.ramped == (force < wanted));
    }
    CHECK(last == 4.0);
    CHECK(silent == Approx(pressed ? kEngageWait : 0.0).margin(2e-3));
    CHECK(ramp == Approx(kEngage).margin(3e-3));
  }
}

TEST_CASE("a force limit keeps the motors' heat at or below that of the continuous force",
          "[safety]") {
  ForceLimits limits{8.0, 2000.0};
  limits.continuous = 2.0;
  limits.heating = 4.0;
  LimiterState state;
  double energy = 0.0;
  double first = 0.0;
  for (int i = 0; i < 60000; ++i) {
    const Vec3 force = limitForce({0, 0, 9}, Vec3::Zero(), 1e-3, limits, state).force;
    // Computes the motors' heat independently of the limiter.
    energy += 1e-3 / limits.heating * (force.squaredNorm() - energy);
    if (i == 100) first = force.norm();
    REQUIRE(state.heat <= 4.0 * (1.0 + 1e-12));
    REQUIRE(energy <= 4.0 * (1.0 + 1e-3));
  }
  CHECK(first == Approx(8.0).margin(1e-9));  // cold motors may give the whole peak
  CHECK(state.sent.norm() == Approx(2.0).margin(1e-3));
  // After 20 s of rest the motors are almost cold again.
  for (int i = 0; i < 20000; ++i)
    CHECK(limitForce({0, 0, 0}, Vec3::Zero(), 1e-3, limits, state).force.norm() == 0.0);
  CHECK(state.heat < 0.05);
}

TEST_CASE("the energy tank is applied last and its output is the sent force", "[safety]") {
  ForceLimits limits{10.0, 1e6};
  limits.tank.use = TankUse::kAct;
  limits.tank.arm.viscous = 0.5;
  limits.tank.arm.period = 1e-3;
  LimiterState state;
  CHECK(limitForce({3, 0, 0}, Vec3::Zero(), 1e-3, limits, state).force == Vec3::Zero());
  CHECK(state.sent == Vec3::Zero());
  // A hand that moves by 1 mm per tick against 0.5 N s/m puts in 0.5 mJ. A force of 1 N can extract
  // this energy in one tick.
  const LimitedForce out = limitForce({3, 0, 0}, {-1e-3, 0, 0}, 1e-3, limits, state);
  CHECK(out.drained);
  CHECK(out.limited());
  CHECK(out.force.x() == Approx(1.0).epsilon(1e-6));
  CHECK(out.share == Approx(1.0 / 3.0).epsilon(1e-6));
  CHECK(state.sent == out.force);
  // A tank that only observes reports the same share without reducing the force.
  limits.tank.use = TankUse::kObserve;
  LimiterState watched;
  (void)limitForce(Vec3::Zero(), Vec3::Zero(), 1e-3, limits, watched);
  const LimitedForce seen = limitForce({3, 0, 0}, {-1e-3, 0, 0}, 1e-3, limits, watched);
  CHECK_FALSE(seen.drained);
  CHECK_FALSE(seen.limited());
  CHECK(seen.force == Vec3(3, 0, 0));
  CHECK(seen.share == Approx(1.0 / 3.0).epsilon(1e-6));
  limits.tank.use = TankUse::kAct;
  state.forget();
  CHECK(state.tank.energy() == 0.0);
  CHECK(limitForce({3, 0, 0}, {-1e-3, 0, 0}, 1e-3, limits, state).force == Vec3::Zero());
  // Invalid input gives no force and leaves the tank's energy finite.
  const double nan = std::numeric_limits<double>::quiet_NaN();
  CHECK(limitForce({nan, 0, 0}, {nan, 0, 0}, 1e-3, limits, state).force == Vec3::Zero());
  CHECK(std::isfinite(state.tank.energy()));
}

}  // namespace palpate::limit_force_test
