/// Tests the demo's scene on a real head tick by tick, and counts allocations, locks and
/// exceptions. head.sh imports the head and runs this test.
#include <cstdio>
#include <cstdlib>

#include <catch2/catch.hpp>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/engine/tick/step.h"
#include "palpate/scenes/library/scene_file.h"
#include "tests/support/counters.h"

using namespace palpate;

TEST_CASE("ticks on the head scene never allocate, lock or throw, and more than 99.5 % converge",
          "[head][realtime]") {
  const char* file = std::getenv("PALPATE_HEAD");
  REQUIRE(file != nullptr);
  const BuiltScene built = buildScene(openScene(file));
  SimulatedDevice device({}, {}, explore(built.bounds, 20.0), 1000.0);
  Reader reader;
  ProxyState state(device.info().limits);
  long two = 0;
  long converged = 0;
  long ticks = 0;
  double most = 0.0;
  bool within = true;
  const test::CountScope scope;
  while (!device.ended()) {
    const StepReport r = hapticStep(*built.scene, reader, device.read(), state, 1e-3);
    device.write(r.force);
    ++ticks;
    two += static_cast<long>(r.primitives >= 2);
    converged += static_cast<long>(r.status == StepStatus::kConverged);
    most = std::max(most, r.force.norm());
    within = within && r.force.allFinite() && r.force.norm() <= device.info().limits.peak;
  }
  const test::Counts counts = test::CountScope::counts();
  CHECK(counts.allocations == 0);
  CHECK(counts.locks == 0);
  CHECK(counts.exceptions == 0);
  CHECK(within);
  // In a sulcus the proxy may not converge within the allowed sub-steps.
  CHECK(ticks - converged < ticks / 200);
  CHECK(two > 1000);  // ticks with both a surface and tissue
  CHECK(most > 2.0);  // the brain was pressed: the skin yields at 1.5 N
  CHECK(sideOf(state.memory(0)) == Side::kOutside);
}
