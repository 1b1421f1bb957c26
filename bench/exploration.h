/// Records the balances of successive ticks, as a hand causes them, to time warm starts under
/// realistic motion.
#pragma once

#include <cstdint>
#include <vector>

#include "tests/support/problems.h"

namespace palpate::bench {

/// One tick's balance.
struct RecordedBalance {
  BalanceProblem problem;  ///< `start` is the proxy of the previous tick.
  double speed = 0.0;      ///< Speed of the hand [m/s].
  bool first = false;      ///< True: this balance does not continue the previous one in the list.
};

/// Scenes to explore: a ball of radius 40 mm whose surface has strength 2 N, and a second mode at
/// the same place.
enum class Explored {
  kSurfaceAndDrag,  ///< Viscosity with strength 0.3 N: a plane and a point.
  /// A vortex that is followed with strength 0.7 N: a plane and a line, at any angle.
  kSurfaceAndStream,
};

/// Records an exploration by the simulated hand: `seconds` [s] at 1 kHz through hapticStep, in
/// virtual time. The hand has a tremor (0.1 mm, 8 to 12 Hz) that depends on the seed. For each
/// tick, records the balance of its last sub-step. Ticks away from the ball have fewer than two
/// primitives.
[[nodiscard]] std::vector<RecordedBalance> recordExploration(Explored what, double seconds,
                                                             std::uint64_t seed);

/// Returns `windows` stretches of `length` ticks that balance `count` primitives, spread evenly
/// over the recording. Sets `first` where a stretch begins or where ticks with other counts were
/// skipped.
[[nodiscard]] std::vector<RecordedBalance> windowsOf(const std::vector<RecordedBalance>& recording,
                                                     std::size_t count, std::size_t windows,
                                                     std::size_t length);

/// Where a walk's primitives are anchored.
enum class Anchoring {
  kFixed,  ///< All stay anchored at the point where the hand began.
  /// Anchored at the proxy in each tick, as modes do. Their directions change by about 1e-3 rad per
  /// tick.
  kCarried,
};

/// Records `walks` random walks of a hand, each of `ticks` at 1 kHz, about 5 mm wide and 0.2 m/s
/// fast (rms). Around the hand are `count` primitives of any kind; k = 500 N/m. Strengths go up to
/// 6 N / `count`, so that with any number of primitives the proxy partly sticks and partly slides.
[[nodiscard]] std::vector<RecordedBalance> recordWalks(Anchoring anchoring, int count,
                                                       std::size_t walks, std::size_t ticks,
                                                       std::uint64_t seed);

}  // namespace palpate::bench
