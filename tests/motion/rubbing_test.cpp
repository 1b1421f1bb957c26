/// A hand that rubs along a noisy scan.
#include "bench/rubbing.h"

#include <cstdlib>
#include <string>

#include <catch2/catch.hpp>

using namespace palpate::bench;

TEST_CASE("rubbing on a scan buzzes no less if planes may not lift the proxy",
          "[.][data][motion]") {
  // tests/motion/data_test.sh imports it: 64 x 64 x 93, a head 3.2 wide in its file's units.
  const char* folder = std::getenv("PALPATE_IMPORTED");
  REQUIRE(folder != nullptr);
  const Rubbing r = rub(std::string(folder) + "/head.vdb", 500.0, 0.064, 0.05);
  CAPTURE(r.ticks, r.force, r.engine.buzz, r.held.buzz, r.engine.given, r.held.given, r.injected);
  CHECK(r.force > 0.1);
  CHECK(r.unfinished == 0.0);
  CHECK(r.engine.buzz < 0.02 * r.force);
  CHECK(r.engine.buzz < 1.3 * r.held.buzz);
  CHECK(r.held.given < 1e-12);
  // The ledger counts at least what is given.
  CHECK(r.engine.given > 0.0);
  CHECK(r.injected >= r.engine.given);
}
