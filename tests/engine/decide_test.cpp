/// Tests each case of decide(), which chooses the next action after a trial step or a sweep.
#include "palpate/engine/tick/decide.h"

#include <array>

#include <catch2/catch.hpp>

namespace palpate::decide_test {
namespace {

/// A row of the table for TrialState: read, within, spent, held.
struct TrialRow {
  TrialState state;
  Next next;
};

/// A row of the table for SweepState: complete, strays, chosen_out, met_before.
struct SweepRow {
  SweepState state;
  Next next;
};

constexpr bool kNo = false;
constexpr bool kYes = true;

}  // namespace

TEST_CASE(
    "after a trial step the tick reads again, ends, waits or releases the proxy, by its state",
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
      // The remaining distance is within the tolerance: the proxy has arrived, even if no reading
      // is left.
      {{kYes, kYes, kNo, kNo}, Next::kArrive},
      {{kYes, kYes, kNo, kYes}, Next::kArrive},
      {{kYes, kYes, kYes, kNo}, Next::kArrive},
      {{kYes, kYes, kYes, kYes}, Next::kArrive},
      // The tick may read again.
      {{kYes, kNo, kNo, kNo}, Next::kRead},
      {{kYes, kNo, kNo, kYes}, Next::kRead},
      // The tick may not read again.
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
      {{kNo, kNo, kNo, kNo}, Next::kRead},  // first surface on the path
      // A second surface ends the search along the path.
      {{kNo, kNo, kNo, kYes}, Next::kRelease},
      {{kNo, kNo, kYes, kNo}, Next::kRead},
      {{kNo, kYes, kNo, kNo}, Next::kRead},  // the path enters new parts, even after a surface
      {{kNo, kYes, kNo, kYes}, Next::kRead},
      {{kNo, kYes, kYes, kNo}, Next::kRelease},  // parts must not be chosen again
      {{kYes, kNo, kNo, kNo}, Next::kRelease},   // the path is searched up to the hand
      {{kYes, kYes, kNo, kYes}, Next::kRelease},
  }};
  for (const SweepRow& row : kRows) {
    CAPTURE(row.state.complete, row.state.strays, row.state.chosen_out, row.state.met_before);
    CHECK(decide(row.state) == row.next);
  }
}

}  // namespace palpate::decide_test
