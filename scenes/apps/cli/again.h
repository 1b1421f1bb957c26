/// Writes the commands of `palpate explain` for a tick of a run.
#pragma once

#include <string>

#include "palpate/scenes/apps/cli/felt.h"
#include "palpate/scenes/apps/cli/session.h"

namespace palpate::cli {

/// Formats a position, rounded to 1e-5 of its unit and to five digits: "0.012,0,-0.00351".
[[nodiscard]] std::string placeWords(const Vec3& p);

/// A push in one tick.
struct Again {
  Vec3 at = Vec3::Zero();    ///< Option --at: position at which the hand rests before the tick [m].
  Vec3 push = Vec3::Zero();  ///< Option --push: move of the hand from `at` within the tick [m].
  double rate = 1000.0;      ///< Option --rate [Hz].
  double spring = 0.0;       ///< Force of the spring [N].
};

/// Returns a push at the place of `most`, with moving volumes at their pose of time 0. The hand
/// starts on the proxy's side of a surface, so that the surface stops the proxy. Tries several
/// starts in `scene`, and selects the start with the spring force nearest to that of `most`.
/// `scene` is the scene that the command will read, which may differ from the scene of `most`.
[[nodiscard]] Again againOf(const Most& most, const Scene& scene, double rate);

/// Returns "palpate explain SCENE --at x,y,z --push x,y,z", with coordinates rounded to 100 nm, and
/// with --rate if it is not 1000 Hz. SCENE is quoted for a shell if necessary.
[[nodiscard]] std::string explainLine(const std::string& scene, const Again& again);

/// Returns "palpate explain SCENE --device replay:FILE --until TIME".
[[nodiscard]] std::string explainLine(const std::string& scene, const std::string& recording,
                                      double time);

/// Returns true if explainLine() has a command that repeats the run of hand `h`: the run was in
/// virtual time or is recorded without lost ticks, and its scene was not edited.
[[nodiscard]] bool repeats(const Run& run, std::size_t h);

/// Returns "palpate explain SCENE --until TIME", with the options of the run that affect hand `h`,
/// for a run that repeats() accepts.
[[nodiscard]] std::string explainLine(const Run& run, std::size_t h, double time);

}  // namespace palpate::cli
