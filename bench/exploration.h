/// Records the balances of successive ticks, to time warm starts under realistic motion.
#pragma once

#include <cstdint>
#include <vector>

#include "tests/support/problems.h"

namespace palpate::bench {

struct RecordedBalance {
  BalanceProblem problem;  ///< `start` is the proxy before the balance.
  double speed = 0.0;      ///< Speed of the hand [m/s].
  bool first = false;      ///< True if this balance does not continue the previous one in the list.
};

/// A ball of radius 40 mm with a surface of strength 2 N, and a second mode at the same place.
enum class Explored {
  kSurfaceAndDrag,  ///< The second mode is viscosity with strength 0.3 N: a plane and a point.
  /// The second mode follows a vortex with strength 0.7 N: a plane and a line, at any angle.
  kSurfaceAndStream,
};

/// Records an exploration by the simulated hand: `seconds` [s] at 1 kHz through hapticStep, in
/// virtual time, with a tremor (up to 0.2 mm, 8 to 12 Hz) that depends on the seed. Records the
/// balance of each tick's last sub-step. Ticks away from the ball have fewer than two primitives.
[[nodiscard]] std::vector<RecordedBalance> recordExploration(Explored what, double seconds,
                                                             std::uint64_t seed);

/// Returns up to `windows` sections of up to `length` ticks that balance `count` primitives, spread
/// evenly over the recording. Sets `first` where ticks were skipped, and in the first tick.
[[nodiscard]] std::vector<RecordedBalance> windowsOf(const std::vector<RecordedBalance>& recording,
                                                     std::size_t count, std::size_t windows,
                                                     std::size_t length);

/// Anchors of a walk's primitives.
enum class Anchoring {
  kFixed,  ///< All primitives stay anchored at the point where the hand began.
  /// All primitives are anchored at the proxy in each tick, as in anchored modes. Directions change
  /// at random, by about 1e-3 rad per tick.
  kCarried,
};

/// Records `walks` random walks of `ticks` ticks at 1 kHz among `count` primitives of any kind,
/// with k = 500 N/m. Along each axis, the rms displacement is about 4 mm and the rms speed about
/// 0.2 m/s. Strengths go up to 6 N / `count`, so that the proxy partly sticks and partly slides.
[[nodiscard]] std::vector<RecordedBalance> recordWalks(Anchoring anchoring, int count,
                                                       std::size_t walks, std::size_t ticks,
                                                       std::uint64_t seed);

}  // namespace palpate::bench
