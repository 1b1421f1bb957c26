/// A hand that slides along the skin of a scan. Real data are noisy, so newly placed planes move
/// the proxy to and fro, which a hand may feel as a buzz. They may also move the proxy away from
/// the hand, which adds energy. The measurement shows whether it helps to hold the proxy back: the
/// proxy could move away only while the hand moves.
#pragma once

#include <memory>
#include <string>

#include "palpate/engine/field/field.h"

namespace palpate::bench {

/// The felt result, of the engine's proxy or of a proxy that is held back.
struct Felt {
  double buzz =
      0.0;  ///< Force less its mean over 10 ms, which leaves frequencies above 100 Hz [N rms].
  double given = 0.0;  ///< Growth of the spring's energy by the proxy alone [J/m].
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
  Felt held;  ///< The proxy turns about the hand, and is never farther from it than before.
};

/// Returns a scan's first grid about the origin. `scale` converts the file's lengths to the hand's
/// metres. Throws if the file cannot be read or the grid does not hold scalars.
[[nodiscard]] std::shared_ptr<const ScalarField> scanField(const std::string& file, double scale);

/// A rattle: the force of a slide jumps from tick to tick while an exact proxy's does not.
struct Rattling {
  static constexpr double kLeap = 0.1;  ///< [N] in a tick.

  long sites = 0;
  long ticks = 0;
  long leaps = 0;        ///< Ticks with a larger change than kLeap.
  long alone = 0;        ///< Leaps without an exact leap of half their size within 20 ticks,
  double largest = 0.0;  ///< The largest lone leap [N].
};

/// Slides along the surface V = level, solid above, of a scan's field (scanField). Each slice about
/// the middle of the data has four arcs of 5 cm. The path is 1 mm below the skin, smoothed as by a
/// hand that cannot follow changes faster than 5 Hz.
Rubbing rub(const std::string& file, double level, double scale, double speed, int slices = 7);

/// Compares the same slides with those of a proxy that advances 16 times a tick to a hundredth of
/// the tolerance.
Rattling rattle(const std::string& file, double level, double scale, double speed, int slices = 6);

}  // namespace palpate::bench
