/// Contact where surfaces are concave or rough: grooves, cubes, noise and presses, each turned
/// against the grid, and what the engine makes of them. Lengths are in voxels as in
/// motion_problems.h.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "palpate/engine/graph.h"
#include "palpate/engine/scene.h"

namespace palpate::bench {

/// What a row of runs came to, over the ticks in which the surface held the hand.
struct ContactResult {
  long runs = 0;
  long held = 0;             ///< Ticks.
  long capped = 0;           ///< Of them at the limit of readings.
  long readings = 0;         ///< In all of them,
  long cells = 0;            ///< and walked.
  long converged = 0;        ///< Ticks that were, and did not yield.
  long off = 0;              ///< Of those, off the interpolated surface by more than the tolerance,
  double off_most = 0.0;     ///< by so much,
  double off_squares = 0.0;  ///< and the sum of squares.
  double deepest = 0.0;      ///< Behind both the true surface and the interpolated one.
  long leaked = 0;           ///< Runs that came more than a voxel behind these.
  long holds = 0;            ///< Of 150 ms, the hand still:
  long unfinished = 0;       ///< that stand at the limit and do not go on.
  double hardest = 0.0;      ///< Force by the one surface's strength,
  long over = 0;             ///< ticks in which that is more than 1.05.
  std::vector<double> times;  ///< Of each of these ticks [ns], where none is proven (theorem.h).

  [[nodiscard]] double cappedShare() const { return share(capped, held); }
  [[nodiscard]] double readingsPerTick() const { return share(readings, held); }
  [[nodiscard]] double cellsPerTick() const { return share(cells, held); }
  [[nodiscard]] double offRms() const;

 private:
  static double share(long a, long b) {
    return b > 0 ? static_cast<double>(a) / static_cast<double>(b) : 0.0;
  }
};

/// How a row is run.
struct ContactRuns {
  long frames = 48;  ///< Each turned otherwise, its hand another.
  std::uint64_t seed = 1;
  ModeKind kind = ModeKind::kIsosurface;
  StepParams step;
};

/// In a groove of an opening [degrees], strength 20 N: the hand comes in and goes to and fro along
/// the edge and across it, 1 to 4 voxels past the bottom, at 0.02 to 2 m/s by turns.
ContactResult feelGrooves(double opening, const ContactRuns& runs);
/// A hand that wanders 1 to 4 voxels under a surface (of a ball at most 0.6 of its radius), at 0.1
/// to 0.6 voxel a tick: of a ball,
ContactResult feelBalls(double radius, const ContactRuns& runs);
/// of a cube of 24 voxels, from inside or outside,
ContactResult feelCubes(bool hollow, const ContactRuns& runs);
/// and of the sum of 60 waves of this length.
ContactResult feelNoise(double wavelength, const ContactRuns& runs);
/// Through volumes of random values at corners so far apart, 20 presses each, strength 3 N.
ContactResult pressNoise(double grain, const ContactRuns& runs);

}  // namespace palpate::bench
