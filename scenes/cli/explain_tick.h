/// One tick, and why its force is what it is: what `palpate explain` prints, and scripts read.
#pragma once

#include "palpate/scenes/cli/touch.h"

namespace palpate::cli {

struct Explained {
  OrderedJson json;    ///< As docs/formats.md has it.
  bool fault = false;  ///< The force was cut: a sample was not finite.
};

/// The hand rests at `at` [m] and then moves by `push` [m], within one tick of 1/rate. Throws Error
/// as openFor, and where a place is out of reach or the rate is none.
[[nodiscard]] Explained explainTick(SceneSpec spec, const Vec3& at, const Vec3& push, double rate,
                                    const Progress& progress, const Say& say);

}  // namespace palpate::cli
