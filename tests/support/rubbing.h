/// Measures a hand that slides along the skin of a scan. Real data are noisy, so newly placed
/// planes move the proxy back and forth, and the hand may feel a vibration. The planes may also
/// move the proxy away from the hand, which adds energy. The measurement shows the effect of a
/// rule: the proxy may move away only while the hand moves.
#pragma once

#include <memory>
#include <string>

#include "palpate/engine/field/field.h"

namespace palpate::bench {

/// Quantities of the engine's proxy, or of a proxy that is held back.
struct Felt {
  double buzz =
      0.0;  ///< Force without its mean over 10 ms, which leaves frequencies above 100 Hz [N rms].
  double given = 0.0;  ///< Growth of the spring's energy by the proxy's motion alone [J/m].
};

struct Rubbing {
  long slides = 0;
  long ticks = 0;
  double metres = 0.0;
  double force = 0.0;       ///< Mean [N].
  double injected = 0.0;    ///< StepReport::injected [J/m].
  double samples = 0.0;     ///< Mean per tick.
  double unfinished = 0.0;  ///< Share of ticks that did not converge.
  Felt engine;
  /// The same quantities for a proxy that turns about the hand but never moves farther from the
  /// hand.
  Felt held;
};

/// Returns a scan's first grid, centred at the origin. `scale` converts the file's lengths to the
/// hand's metres. Throws if the file cannot be read or the grid does not hold scalars.
[[nodiscard]] std::shared_ptr<const ScalarField> scanField(const std::string& file, double scale);

/// A rattle: the force of a slide jumps from tick to tick, while the force of an exact proxy does
/// not.
struct Rattling {
  static constexpr double kLeap = 0.1;  ///< Smallest change in a tick that is a leap [N].

  long sites = 0;
  long ticks = 0;
  long leaps = 0;  ///< Number of ticks whose force changes by more than kLeap.
  /// Number of leaps for which the exact force has no leap of half the size within 20 ticks.
  long alone = 0;
  double largest = 0.0;  ///< Largest of these leaps [N].
};

/// Slides along the surface V = level of a scan's field (scanField), with the solid above the
/// level. Each slice about the middle of the data has four arcs of 5 cm. The path is 1 mm below the
/// skin and smoothed, because a hand cannot follow changes faster than 5 Hz.
Rubbing rub(const std::string& file, double level, double scale, double speed, int slices = 7);

/// Compares the same slides with those of a proxy that advances 16 times per tick, with a hundredth
/// of the tolerance.
Rattling rattle(const std::string& file, double level, double scale, double speed, int slices = 6);

}  // namespace palpate::bench
