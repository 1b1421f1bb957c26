/// Balances as a hand meets them, tick after tick: what warm starts and real hands are timed on.
#pragma once

#include <cstdint>
#include <vector>

#include "tests/support/problems.h"

namespace palpate::bench {

/// One tick's balance.
struct RecordedBalance {
  BalanceProblem problem;  ///< `start` is the proxy before.
  double speed = 0.0;      ///< Of the hand [m/s].
  bool first = false;      ///< Does not follow from the balance before it in the list.
};

/// What is explored: a ball of 40 mm whose surface holds 2 N, and a second property of the same
/// place.
enum class Explored {
  kSurfaceAndDrag,    ///< A drag of 0.3 N (viscosity): a plane and a point.
  kSurfaceAndStream,  ///< A vortex that is followed with 0.7 N: a plane and a line, at any angle.
};

/// The simulated hand explores for `seconds` at 1 kHz through hapticStep, in virtual time; its
/// tremor (0.1 mm, 8 to 12 Hz) follows from the seed. Of every tick, the last sub-step's balance;
/// ticks away from the ball have fewer than two primitives.
[[nodiscard]] std::vector<RecordedBalance> recordExploration(Explored what, double seconds,
                                                             std::uint64_t seed);

/// `windows` stretches of `length` ticks, evenly over the recording, of the ticks that balance
/// `count` primitives; `first` is set where a stretch begins or ticks were left out.
[[nodiscard]] std::vector<RecordedBalance> windowsOf(const std::vector<RecordedBalance>& recording,
                                                     std::size_t count, std::size_t windows,
                                                     std::size_t length);

/// How the primitives of a walk stand.
enum class Anchoring {
  kFixed,    ///< All at the point where the hand began.
  kCarried,  ///< Placed anew at the proxy each tick, as modes do, their directions turning by some
             ///< 1e-3 rad.
};

/// `walks` random walks of a hand, `ticks` at 1 kHz each, some 5 mm and 0.2 m/s rms, about `count`
/// primitives of any kind; k = 500 N/m. Strengths to 6 N over their number, so that the hand drags
/// many of them along as it does two: part of the time the proxy sticks, part it slides.
[[nodiscard]] std::vector<RecordedBalance> recordWalks(Anchoring anchoring, int count,
                                                       std::size_t walks, std::size_t ticks,
                                                       std::uint64_t seed);

}  // namespace palpate::bench
