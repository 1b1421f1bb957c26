/// Explanation of one tick and its force: the output of `palpate explain`, also for scripts.
#pragma once

#include "palpate/scenes/apps/common/touch.h"

namespace palpate::cli {

struct Explained {
  OrderedJson json;    ///< In the format of docs/formats.md.
  bool fault = false;  ///< The force was cut: a sample was not finite.
};

/// Explains a tick of 1/rate: the hand rests at `at` [m] and then moves by `push` [m] within the
/// tick. Throws Error as openFor does, and if a place is out of reach or the rate is invalid.
[[nodiscard]] Explained explainTick(SceneSpec spec, const Vec3& at, const Vec3& push, double rate,
                                    const Progress& progress, const Say& say);

}  // namespace palpate::cli
