/// Reproduces one tick of a run as a command of `palpate explain`.
#pragma once

#include <optional>
#include <string>

#include "palpate/scenes/apps/cli/felt.h"

namespace palpate::cli {

/// Formats a position [m], rounded to 0.01 mm and five digits: "0.012,0,-0.00351".
[[nodiscard]] std::string placeWords(const Vec3& p);

/// The options of a command that reproduces a tick.
struct Again {
  Vec3 at = Vec3::Zero();    ///< Option --at: position at which the hand rests before the tick [m].
  Vec3 push = Vec3::Zero();  ///< Option --push: move of the hand from `at` within the tick [m].
  double off = 0.0;  ///< Difference of the spring's force, divided by that of the reproduced tick.
};

/// Returns a hand's motion that reproduces `most` in one tick, with moving volumes at their pose of
/// time 0. The hand starts on the proxy's side of a surface, so that the surface stops the proxy.
/// Tries several starts in `scene`, and selects the start with the nearest spring force. Returns no
/// value if this force differs by over 10 %. `scene` is the scene that the command will read, which
/// may differ from the scene of `most`.
[[nodiscard]] std::optional<Again> againOf(const Most& most, const Scene& scene);

/// Returns "palpate explain SCENE --at x,y,z --push x,y,z", with coordinates rounded to 100 nm.
/// SCENE is quoted for a shell.
[[nodiscard]] std::string explainLine(const std::string& scene, const Again& again);

}  // namespace palpate::cli
