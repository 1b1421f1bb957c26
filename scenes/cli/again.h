/// A moment of a run as `palpate explain` has it again.
#pragma once

#include <optional>
#include <string>

#include "palpate/scenes/cli/felt.h"

namespace palpate::cli {

/// A place as options take it, to a hundredth of a millimetre: "0.012,0,-0.00351".
[[nodiscard]] std::string placeWords(const Vec3& p);

/// What explain is to be given.
struct Again {
  Vec3 at = Vec3::Zero();    ///< Where the hand rests [m].
  Vec3 push = Vec3::Zero();  ///< How far it then moves [m].
};

/// The hand at that moment, which comes from before the proxy: so a surface finds it on its free
/// side. How far before is tried on the scene, if it is still that one, and the best taken; none
/// where the force of none is within a tenth: what the proxy had passed or left is not had again by
/// one move. What moves is felt where it stood when the scene began.
[[nodiscard]] std::optional<Again> againOf(const Most& most, const Scene& scene);

/// "palpate explain SCENE --at x,y,z --push x,y,z", as a shell takes it.
[[nodiscard]] std::string explainLine(const std::string& scene, const Again& again);

}  // namespace palpate::cli
