/// Tests decide(), which chooses the next action after a trial step or a sweep.
#include "palpate/engine/tick/decide.h"

#include <array>

#include <catch2/catch.hpp>

namespace palpate::decide_test {
namespace {

/// A row of the table for TrialState. Its flags are in the order read, within, spent, held.
struct TrialRow {
  TrialState state;
  Next next;
};

/// A row of the table for SweepState. Its flags are in the order complete, strays, chosen_out,
/// met_before.
struct SweepRow {
  SweepState state;
  Next next;
};

constexpr bool kNo = false;
constexpr bool kYes = true;

}  // namespace

TEST_CASE("the state after a trial step decides whether the tick reads, arrives, waits or releases",
          "[step]") {
  constexpr std::array<TrialRow, 16> kRows{{
      // Without a reading, the next action is always a reading.
      {{kNo, kNo, kNo, kNo}, Next::kRead},
      {{kNo, kNo, kNo, kYes}, Next::kRead},
      {{kNo, kNo, kYes, kNo}, Next::kRead},
      {{kNo, kNo, kYes, kYes}, Next::kRead},
      {{kNo, kYes, kNo, kNo}, Next::kRead},
      {{kNo, kYes, kNo, kYes}, Next::kRead},
      {{kNo, kYes, kYes, kNo}, Next::kRead},
      {{kNo, kYes, kYes, kYes}, Next::kRead},
      // The error is within the tolerance, so the proxy has arrived, even if no readings are left.
      {{kYes, kYes, kNo, kNo}, Next::kArrive},
      {{kYes, kYes, kNo, kYes}, Next::kArrive},
      {{kYes, kYes, kYes, kNo}, Next::kArrive},
      {{kYes, kYes, kYes, kYes}, Next::kArrive},
      // Readings are left, so the tick reads again.
      {{kYes, kNo, kNo, kNo}, Next::kRead},
      {{kYes, kNo, kNo, kYes}, Next::kRead},
      // No readings are left. The proxy waits if a primitive holds it, else the tick releases it.
      {{kYes, kNo, kYes, kYes}, Next::kWait},
      {{kYes, kNo, kYes, kNo}, Next::kRelease},
  }};
  for (const TrialRow& row : kRows) {
    CAPTURE(row.state.read, row.state.within, row.state.spent, row.state.held);
    CHECK(decide(row.state) == row.next);
  }
}

TEST_CASE("a free proxy reads the field at the first surface and at new parts on its path",
          "[step]") {
  constexpr std::array<SweepRow, 8> kRows{{
      {{kNo, kNo, kNo, kNo}, Next::kRead},  // the sweep ends at the first surface
      // The sweep ends at a second surface.
      {{kNo, kNo, kNo, kYes}, Next::kRelease},
      {{kNo, kNo, kYes, kNo}, Next::kRead},
      {{kNo, kYes, kNo, kNo}, Next::kRead},  // the sweep led to new parts
      {{kNo, kYes, kNo, kYes}, Next::kRead},
      {{kNo, kYes, kYes, kNo}, Next::kRelease},  // the limit on choices of parts is reached
      {{kYes, kNo, kNo, kNo}, Next::kRelease},   // the sweep reached the hand
      {{kYes, kYes, kNo, kYes}, Next::kRelease},
  }};
  for (const SweepRow& row : kRows) {
    CAPTURE(row.state.complete, row.state.strays, row.state.chosen_out, row.state.met_before);
    CHECK(decide(row.state) == row.next);
  }
}

}  // namespace palpate::decide_test
