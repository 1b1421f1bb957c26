#include "palpate/engine/modes/transfer.h"

#include <cmath>
#include <limits>

#include <catch2/catch.hpp>

#include "palpate/engine/error.h"

namespace palpate::transfer_test {

TEST_CASE("a transfer function that is a number gives the same strength for all inputs",
          "[transfer]") {
  const TransferFunction f = 1.5;
  CHECK(f.isConstant());
  CHECK(f(-1e300) == 1.5);
  CHECK(f(0.0) == 1.5);
}

TEST_CASE("a transfer window rises from zero to its maximum about its level", "[transfer]") {
  const auto f = TransferFunction::window(100.0, 40.0, 2.0);
  CHECK(f(79.0) == 0.0);
  CHECK(f(80.0) == 0.0);
  CHECK(f(100.0) == Approx(1.0));
  CHECK(f(110.0) == Approx(1.5));
  CHECK(f(120.0) == 2.0);
  CHECK(f(1e9) == 2.0);
}

TEST_CASE("a piecewise curve is linear between its points and constant beyond", "[transfer]") {
  const auto f = TransferFunction::piecewise({{0, 0}, {0.3, 1}, {0.3, 2}, {1, 4}});
  CHECK(f(-5) == 0.0);
  CHECK(f(0.15) == Approx(0.5));
  CHECK(f(0.3) == 2.0);  // at a step, the curve has the later point's value
  CHECK(f(0.65) == Approx(3.0));
  CHECK(f(2) == 4.0);
}

TEST_CASE("a transfer function gives zero for a NaN input", "[transfer]") {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  CHECK(TransferFunction(2.0)(nan) == 0.0);
  CHECK(TransferFunction::window(0, 1, 1)(nan) == 0.0);
  CHECK(std::isfinite(TransferFunction::window(0, 1, 1)(std::numeric_limits<double>::infinity())));
}

TEST_CASE("negative, infinite and disordered transfer curves are refused", "[transfer]") {
  const double inf = std::numeric_limits<double>::infinity();
  CHECK_THROWS_AS(TransferFunction(-1.0), palpate::SceneError);
  CHECK_THROWS_AS(TransferFunction(inf), palpate::SceneError);
  CHECK_THROWS_AS(TransferFunction::window(0, 0, 1), palpate::SceneError);
  CHECK_THROWS_AS(TransferFunction::window(0, 1, -1), palpate::SceneError);
  CHECK_THROWS_AS(TransferFunction::piecewise({}), palpate::SceneError);
  CHECK_THROWS_AS(TransferFunction::piecewise({{1, 0}, {0, 1}}), palpate::SceneError);
  CHECK_THROWS_AS(TransferFunction::piecewise({{0, 0}, {1, -1}}), palpate::SceneError);
}

}  // namespace palpate::transfer_test
