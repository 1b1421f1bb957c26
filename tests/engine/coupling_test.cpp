#include "palpate/engine/balance/coupling.h"

#include <cmath>
#include <cstring>
#include <limits>

#include <catch2/catch.hpp>

#include "tests/support/random.h"

namespace palpate::coupling_test {
using palpate::test::Random;

TEST_CASE("the coupling acts as a spring and a damper from probe to proxy", "[coupling][eq3]") {
  const Vec3 f = couplingForce({500.0, 2.0}, {1e-3, 0, 0}, 0.1);
  CHECK((f - Vec3(0.7, 0, 0)).norm() < 1e-15);
  // The damper may reduce the spring's force to zero or double the force, but not more.
  CHECK(couplingForce({500.0, 2.0}, {1e-3, 0, 0}, -9.0) == Vec3::Zero());
  CHECK((couplingForce({500.0, 2.0}, {1e-3, 0, 0}, 9.0) - Vec3(1, 0, 0)).norm() < 1e-15);
  CHECK(couplingForce({500.0, 2.0}, Vec3::Zero(), 0.0) == Vec3::Zero());
}

TEST_CASE("the rate of the spring's length is measured over 2 ms at 500 Hz to 100 kHz",
          "[coupling][eq3]") {
  Random random(3);
  for (const double rate : {500.0, 1000.0, 4000.0, 10000.0, 64000.0, 100000.0}) {
    CAPTURE(rate);
    LengthRate steady;
    LengthRate uneven;
    CHECK(steady.next(1.0, 1.0 / rate) == 0.0);
    CHECK(uneven.next(1.0, 1.0 / rate) == 0.0);
    double time = 0.0;
    double length = 0.0;
    for (int i = 0; i < 1000; ++i) {
      // The length changes at 0.3 m/s. The measured rate must be 0.3 m/s from the second tick on.
      REQUIRE(steady.next(1.0 + 0.3 * (i + 1) / rate, 1.0 / rate) == Approx(0.3).epsilon(1e-6));
      const double dt = random.uniform(0.7, 1.3) / rate;
      time += dt;
      length = 1.0 + 0.3 * time;
      REQUIRE(uneven.next(length, dt) == Approx(0.3).epsilon(1e-6));
    }
    // One encoder step changes the measured rate for 2 ms, at least for a tick. The sum of these
    // rates, times the tick length, must be the encoder step.
    LengthRate stepped;
    for (int i = 0; i < 300; ++i) (void)stepped.next(0.0, 1.0 / rate);
    double sum = 0.0;
    int seen = 0;
    for (int i = 0; i < 300; ++i) {
      const double found = stepped.next(1e-5, 1.0 / rate);
      sum += found / rate;
      seen += found != 0.0 ? 1 : 0;
    }
    CHECK(seen == std::max(1, static_cast<int>(kRateTime * rate + 0.5)));
    CHECK(sum == Approx(1e-5));
    CHECK(steady.next(2.0, 0.0) == 0.0);
    CHECK(steady.next(2.0, std::numeric_limits<double>::quiet_NaN()) == 0.0);
    steady.forget();
    CHECK(steady.next(7.0, 1.0 / rate) == 0.0);
    CHECK(steady.next(7.0 + 1.0 / rate, 1.0 / rate) == Approx(1.0));
  }
}

}  // namespace palpate::coupling_test
