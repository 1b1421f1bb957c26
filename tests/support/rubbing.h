/// A hand that rubs along the skin of a scan. Real data are noisy: planes that are placed anew move
/// the proxy to and fro, which may be felt as buzz, and may move it away from the hand, which gives
/// energy. Would it help to let it do so only as the hand goes on?
#pragma once

#include <memory>
#include <string>

#include "palpate/engine/field.h"

namespace palpate::bench {

/// What was felt, the engine's proxy or one that is held back.
struct Felt {
  double buzz =
      0.0;  ///< Force less its mean over 10 ms, which leaves what is above 100 Hz [N rms].
  double given = 0.0;  ///< Growth of the spring's energy by the proxy alone [J a metre].
};

struct Rubbing {
  long slides = 0;
  long ticks = 0;
  double metres = 0.0;
  double force = 0.0;       ///< Mean [N].
  double injected = 0.0;    ///< StepReport::injected [J a metre].
  double samples = 0.0;     ///< A tick.
  double unfinished = 0.0;  ///< Share of ticks that did not converge.
  Felt engine;
  Felt held;  ///< The proxy turns about the hand, and is never farther from it than before.
};

/// A scan's first grid about the origin, a voxel of which is `scale` times the file's in the hand's
/// metres. Throws where it cannot be read, or holds no scalars.
[[nodiscard]] std::shared_ptr<const ScalarField> scanField(const std::string& file, double scale);

/// A rattle: the force of a slide leaps from tick to tick where an exact proxy's does not.
struct Rattling {
  static constexpr double kLeap = 0.1;  ///< [N] in a tick.

  long sites = 0;
  long ticks = 0;
  long leaps = 0;        ///< Of them with more than that,
  long alone = 0;        ///< and no exact leap of half as much within 20 ticks,
  double largest = 0.0;  ///< the largest [N].
};

/// Slides along the surface V = level, solid above, of a scan's field (scanField): in so many
/// slices about the middle of the data four arcs of 5 cm each, 1 mm below the skin as a hand finds
/// it that cannot follow what comes oftener than five times a second.
Rubbing rub(const std::string& file, double level, double scale, double speed, int slices = 7);

/// The same slides, beside those of a proxy that goes on 16 times a tick to a hundredth of the
/// tolerance.
Rattling rattle(const std::string& file, double level, double scale, double speed, int slices = 6);

}  // namespace palpate::bench
