#include "engine/coupling.h"

#include <cmath>
#include <cstring>
#include <limits>

#include <catch2/catch.hpp>

#include "tests/support/random.h"

using namespace palpate;
using palpate::test::Random;

TEST_CASE("the coupling is a spring and a damper from probe to proxy", "[coupling][eq3]") {
  const Vec3 f = couplingForce({500.0, 2.0}, {1e-3, 0, 0}, {0.1, -0.3, 0});
  CHECK((f - Vec3(0.7, 0, 0)).norm() < 1e-15);
  // It never pulls the other way, and never more than doubles.
  CHECK(couplingForce({500.0, 2.0}, {1e-3, 0, 0}, {-9, 0, 0}) == Vec3::Zero());
  CHECK((couplingForce({500.0, 2.0}, {1e-3, 0, 0}, {9, 0, 0}) - Vec3(1, 0, 0)).norm() < 1e-15);
  CHECK(couplingForce({500.0, 2.0}, Vec3::Zero(), Vec3::Zero()) == Vec3::Zero());
}

TEST_CASE("a non-finite force becomes zero and says so", "[coupling][safety]") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double inf = std::numeric_limits<double>::infinity();
  for (const double bad : {nan, inf, -inf, 1.7e308}) {
    const LimitedForce out = limitForce({bad, bad, 0}, {1, 0, 0}, 1e-3, {});
    CHECK(out.force == Vec3::Zero());
    CHECK_FALSE(out.finite);
    CHECK(out.limited());
  }
}

TEST_CASE("the peak keeps the direction", "[coupling][safety]") {
  const LimitedForce out = limitForce({30, 40, 0}, {0, 0, 0}, 1.0, {5.0, 1e6});
  CHECK(out.peaked);
  CHECK((out.force - Vec3(3, 4, 0)).norm() < 1e-11);
}

TEST_CASE("growth is limited, a release never delayed", "[coupling][safety]") {
  const ForceLimits limits{10.0, 2000.0};
  const LimitedForce grown = limitForce({5, 0, 0}, {1, 0, 0}, 1e-3, limits);
  CHECK(grown.slewed);
  CHECK((grown.force - Vec3(3, 0, 0)).norm() < 1e-14);

  const LimitedForce released = limitForce({0.5, 0, 0}, {9, 0, 0}, 1e-3, limits);
  CHECK_FALSE(released.limited());
  CHECK(released.force == Vec3(0.5, 0, 0));

  // Turned round: the old force goes at once, the new one grows from nothing.
  const LimitedForce turned = limitForce({-5, 0, 0}, {5, 0, 0}, 1e-3, limits);
  CHECK((turned.force - Vec3(-2, 0, 0)).norm() < 1e-14);
}

TEST_CASE("whatever bits come in, the force is finite and within peak, slew and wish",
          "[coupling][safety]") {
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
    const ForceLimits limits{random.logUniform(0.1, 20.0), random.logUniform(1.0, 1e5)};
    CAPTURE(wanted, previous, dt, limits.peak, limits.slew);
    const LimitedForce out = limitForce(wanted, previous, dt, limits);
    const bool held = out.force.allFinite() && out.force.stableNorm() <= limits.peak &&
                      (!out.finite || out.force.stableNorm() <= wanted.stableNorm() * (1 + 1e-12));
    if (!held) FAIL("not finite, or over the peak or the wish");
    const double last = previous.allFinite() ? previous.stableNorm() : 0.0;
    const double growth = dt > 0 && std::isfinite(dt) ? limits.slew * dt : 0.0;
    if (out.force.stableNorm() >
        (std::isfinite(last) ? last : 0.0) * (1 + 1e-12) + growth * (1 + 1e-12)) {
      FAIL("grew faster than the slew limit");
    }
    finite += out.finite;
  }
  CHECK(finite > 0);
}
