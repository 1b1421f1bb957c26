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
