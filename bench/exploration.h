/// Records balances tick after tick, as a hand meets them, to time warm starts and realistic hands.
#pragma once

#include <cstdint>
#include <vector>

#include "tests/support/problems.h"

namespace palpate::bench {

/// One tick's balance.
struct RecordedBalance {
  BalanceProblem problem;  ///< `start` is the proxy before the tick.
  double speed = 0.0;      ///< Speed of the hand [m/s].
  bool first = false;      ///< Does not follow from the previous balance in the list.
};

/// Scenes to explore: a ball of radius 40 mm whose surface holds 2 N, and a second property of the
/// same place.
enum class Explored {
  kSurfaceAndDrag,    ///< A drag of 0.3 N (viscosity): a plane and a point.
  kSurfaceAndStream,  ///< A vortex that is followed with 0.7 N: a plane and a line, at any angle.
};

/// Records an exploration by the simulated hand: `seconds` at 1 kHz through hapticStep, in virtual
/// time. The hand's tremor (0.1 mm, 8 to 12 Hz) follows from the seed. Each tick records the
/// balance of its last sub-step. Ticks away from the ball have fewer than two primitives.
[[nodiscard]] std::vector<RecordedBalance> recordExploration(Explored what, double seconds,
                                                             std::uint64_t seed);

/// Returns `windows` stretches of `length` ticks, spread evenly over the recording, from the ticks
/// that balance `count` primitives. `first` is set where a stretch begins or ticks were left out.
[[nodiscard]] std::vector<RecordedBalance> windowsOf(const std::vector<RecordedBalance>& recording,
                                                     std::size_t count, std::size_t windows,
                                                     std::size_t length);

/// Placement of a walk's primitives.
enum class Anchoring {
  kFixed,    ///< All stay at the point where the hand began.
  kCarried,  ///< Placed again at the proxy each tick, as modes do. Their directions turn by about
             ///< 1e-3 rad.
};

/// Records `walks` random walks of a hand, `ticks` at 1 kHz each, about 5 mm and 0.2 m/s rms,
/// around `count` primitives of any kind; k = 500 N/m. Strengths go up to 6 N / `count`. With many
/// primitives, as with two, the proxy then sticks part of the time and slides part of the time.
[[nodiscard]] std::vector<RecordedBalance> recordWalks(Anchoring anchoring, int count,
                                                       std::size_t walks, std::size_t ticks,
                                                       std::uint64_t seed);

}  // namespace palpate::bench
