/// Contact with concave or rough surfaces: grooves, cubes, noise and presses. Each is rotated
/// against the grid; the results are the engine's. Lengths are in voxels as in motion_problems.h.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "palpate/engine/scene/graph.h"
#include "palpate/engine/scene/scene.h"

namespace palpate::bench {

/// The result of a row of runs, over the ticks in which the surface held the hand.
struct ContactResult {
  long runs = 0;
  long held = 0;              ///< Ticks.
  long capped = 0;            ///< Held ticks at the limit of readings.
  long readings = 0;          ///< Readings in all held ticks.
  long cells = 0;             ///< Cells walked in all held ticks.
  long converged = 0;         ///< Ticks that converged and did not yield.
  long off = 0;               ///< Converged ticks off the interpolated surface (> tolerance).
  double off_most = 0.0;      ///< Largest distance from it,
  double off_squares = 0.0;   ///< and the sum of squared distances.
  double deepest = 0.0;       ///< Behind both the true and the interpolated surface.
  long leaked = 0;            ///< Runs that came more than a voxel behind both.
  long holds = 0;             ///< Holds of 150 ms with a still hand.
  long unfinished = 0;        ///< Holds that end at the limit of readings and do not move.
  double hardest = 0.0;       ///< Largest force divided by the surface's strength.
  long over = 0;              ///< Ticks in which that ratio is above 1.05.
  std::vector<double> times;  ///< Time of each held tick [ns], if ticks are not proven (theorem.h).

  [[nodiscard]] double cappedShare() const { return share(capped, held); }
  [[nodiscard]] double readingsPerTick() const { return share(readings, held); }
  [[nodiscard]] double cellsPerTick() const { return share(cells, held); }
  [[nodiscard]] double offRms() const;

 private:
  static double share(long a, long b) {
    return b > 0 ? static_cast<double>(a) / static_cast<double>(b) : 0.0;
  }
};

/// How a row runs.
struct ContactRuns {
  long frames = 48;  ///< Each has its own rotation and its own hand.
  std::uint64_t seed = 1;
  ModeKind kind = ModeKind::kIsosurface;
  StepParams step;
};

/// Runs in a groove with an opening [degrees], strength 20 N. The hand comes in and moves to and
/// fro along the edge and across it, 1 to 4 voxels past the bottom. Speeds of 0.02 to 2 m/s take
/// turns.
ContactResult feelGrooves(double opening, const ContactRuns& runs);
/// Runs a hand that wanders 1 to 4 voxels under the surface of a ball (at most 0.6 of its radius),
/// at 0.1 to 0.6 voxel a tick.
ContactResult feelBalls(double radius, const ContactRuns& runs);
/// The same for a cube of 24 voxels, from outside or, if hollow, from inside.
ContactResult feelCubes(bool hollow, const ContactRuns& runs);
/// The same for the sum of 60 waves of about this length.
ContactResult feelNoise(double wavelength, const ContactRuns& runs);
/// Presses through volumes of random values at corners `grain` apart, 20 presses each, strength 3
/// N.
ContactResult pressNoise(double grain, const ContactRuns& runs);

}  // namespace palpate::bench
