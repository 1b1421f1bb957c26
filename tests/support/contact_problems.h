/// Presses hands with the engine on grooves, balls, cubes, waves and noise. Grooves and cubes are
/// rotated relative to the grid. Lengths are in voxels, as in motion_problems.h.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "palpate/engine/scene/graph.h"
#include "palpate/engine/scene/scene.h"

namespace palpate::bench {

/// Results of many runs. A held tick is a tick with a force above 1 uN.
struct ContactResult {
  long runs = 0;
  long held = 0;      ///< Number of held ticks.
  long capped = 0;    ///< Number of held ticks that reached the limit of readings.
  long readings = 0;  ///< Number of readings in all held ticks.
  long cells = 0;     ///< Number of cells that the paths crossed in all held ticks.
  /// Number of held ticks that did not reach the limit of readings and whose force is below 0.999
  /// times the strength. A larger force counts as that of a surface that yields.
  long converged = 0;
  /// Number of converged ticks whose proxy is farther from the interpolated surface than the
  /// tolerance.
  long off = 0;
  /// Largest distance from the interpolated surface in converged ticks.
  double off_most = 0.0;
  double off_squares = 0.0;  ///< Sum of the squared distances in converged ticks.
  /// Largest depth behind both the true and the interpolated surface, as a negative number.
  double deepest = 0.0;
  long leaked = 0;  ///< Number of runs in which that depth exceeded a voxel.
  long holds = 0;   ///< Number of times that the hand rested for 150 ms.
  /// Number of rests whose last 20 ticks all reached the limit of readings, although the proxy
  /// moved less than the tolerance.
  long unfinished = 0;
  double hardest = 0.0;  ///< Largest ratio of the force to the surface's strength.
  long over = 0;         ///< Number of ticks in which this ratio exceeds 1.05.
  /// Time of each held tick [ns]. Empty while the theorem is checked (theorem.h).
  std::vector<double> times;

  [[nodiscard]] double cappedShare() const { return share(capped, held); }
  [[nodiscard]] double readingsPerTick() const { return share(readings, held); }
  [[nodiscard]] double cellsPerTick() const { return share(cells, held); }
  [[nodiscard]] double offRms() const;

 private:
  static double share(long a, long b) {
    return b > 0 ? static_cast<double>(a) / static_cast<double>(b) : 0.0;
  }
};

/// Parameters of many runs.
struct ContactRuns {
  long frames = 48;  ///< Number of random volumes or positions, each with a random hand.
  std::uint64_t seed = 1;
  ModeKind kind = ModeKind::kIsosurface;
  StepParams step;
};

/// Runs a hand in a groove between two planes with this opening [degrees] and a strength of 20 N.
/// The hand moves in at 0.02 to 2 m/s. It then moves back and forth along the bottom line and
/// across it, 1 to 4 voxels below that line.
ContactResult feelGrooves(double opening, const ContactRuns& runs);
/// Runs a hand that wanders below a ball's surface at 0.1 to 0.6 voxel per tick. Its target depth
/// is at most 4 voxels and at most 0.6 times the radius. The strength is 1000 N.
ContactResult feelBalls(double radius, const ContactRuns& runs);
/// Like feelBalls(), for a cube of 24 voxels, from outside or, if `hollow`, from inside.
ContactResult feelCubes(bool hollow, const ContactRuns& runs);
/// Like feelBalls(), for the zero surface of a sum of 60 cosine waves of about this wavelength.
ContactResult feelNoise(double wavelength, const ContactRuns& runs);
/// Presses 20 times into each volume. The volume's values are random at points `grain` voxels
/// apart. The strength is 3 N.
ContactResult pressNoise(double grain, const ContactRuns& runs);

}  // namespace palpate::bench
