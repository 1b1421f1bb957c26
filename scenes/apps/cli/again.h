/// Reproduces a moment of a run for `palpate explain`.
#pragma once

#include <optional>
#include <string>

#include "palpate/scenes/apps/cli/felt.h"

namespace palpate::cli {

/// Formats a place for options, to a hundredth of a millimetre: "0.012,0,-0.00351".
[[nodiscard]] std::string placeWords(const Vec3& p);

/// Input for `palpate explain`.
struct Again {
  Vec3 at = Vec3::Zero();    ///< Position of the hand at rest [m].
  Vec3 push = Vec3::Zero();  ///< Its move from there [m].
};

/// Returns the hand's move to that moment. The hand starts before the proxy, so that a surface
/// finds it on its free side. If the moment belongs to `scene`, tries several start distances
/// and returns the best. Unset if no force is within a tenth: one move cannot reproduce surfaces
/// that the proxy had passed or left. Moving volumes are evaluated where they were when the scene
/// began.
[[nodiscard]] std::optional<Again> againOf(const Most& most, const Scene& scene);

/// Returns "palpate explain SCENE --at x,y,z --push x,y,z", quoted for a shell.
[[nodiscard]] std::string explainLine(const std::string& scene, const Again& again);

}  // namespace palpate::cli
