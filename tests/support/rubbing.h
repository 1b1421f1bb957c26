/// Measures a hand that slides along the skin of a scan. Because of noise, the surface's plane
/// changes from tick to tick. These changes move the proxy back and forth, which a hand can feel as
/// vibration. They can also move the proxy away from the hand, which adds energy. For comparison, a
/// second proxy is held back: its own motion never takes it farther from the hand.
#pragma once

#include <memory>
#include <string>

#include "palpate/engine/field/field.h"

namespace palpate::bench {

/// Results for the engine's proxy, or for the proxy that is held back.
struct Felt {
  /// RMS of the force minus its mean over 10 ms: mainly frequencies above 100 Hz [N].
  double buzz = 0.0;
  double given = 0.0;  ///< Energy that the proxy's motion alone adds to the spring [J/m].
};

struct Rubbing {
  long slides = 0;
  long ticks = 0;
  double metres = 0.0;
  double force = 0.0;       ///< Mean force [N].
  double injected = 0.0;    ///< StepReport::injected [J/m].
  double samples = 0.0;     ///< Mean number of samples per tick.
  double unfinished = 0.0;  ///< Share of ticks that did not converge.
  Felt engine;
  /// Results for the proxy that is held back.
  Felt held;
};

/// Returns the field of a scan's first grid, centred at the origin. `scale` converts the file's
/// lengths to metres. Throws if the file is unreadable or the grid is not scalar.
[[nodiscard]] std::shared_ptr<const ScalarField> scanField(const std::string& file, double scale);

/// Counts leaps: changes of the force by more than kLeap from one tick to the next. Also counts the
/// leaps near which the force of an exact proxy does not change much.
struct Rattling {
  static constexpr double kLeap = 0.1;  ///< A leap is a larger change than this [N].

  long sites = 0;  ///< Number of arcs.
  long ticks = 0;
  long leaps = 0;  ///< Number of leaps.
  /// Number of leaps for which no change of the exact force within 20 ticks is at least half as
  /// large.
  long alone = 0;
  double largest = 0.0;  ///< Largest leap of `alone` [N].
};

/// Slides along the surface V = level of a scan, solid above the level: four arcs of 5 cm in each
/// slice, at `speed` [m/s]. The path is 1 mm below the skin, averaged over 0.2 s, because hands do
/// not follow faster changes.
Rubbing rub(const std::string& file, double level, double scale, double speed, int slices = 7);

/// Compares the same slides with a reference proxy that advances 16 times per tick, with a
/// hundredth of the tolerance.
Rattling rattle(const std::string& file, double level, double scale, double speed, int slices = 6);

}  // namespace palpate::bench
