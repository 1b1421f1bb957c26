/// Private to the scene guess: makes the modes for each kind of grid, with strengths and reasons.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "palpate/scenes/guess/candidate.h"
#include "palpate/scenes/guess/scene_json.h"

namespace palpate::guess {

/// Value of the skin in a CT [HU]: between air (-1000) and fat (-100).
inline constexpr double kSkinHounsfield = -300.0;

/// Returns at most `most` modes, the most important first. Not for constant scalars and level sets.
[[nodiscard]] std::vector<Json> scalarModes(const Candidate& c, std::size_t most);

[[nodiscard]] Json levelSetSurface(const Candidate& c);

/// Returns the surface of a material, which fills the fraction `share` (0 to 1) of the whole
/// volume.
[[nodiscard]] Json materialSurface(const Candidate& c, double share);

/// Return a mode that follows directions. Its strength depends on the lengths of the vectors, or on
/// a measure of anisotropy.
[[nodiscard]] Json followDirections(const Candidate& directions);
[[nodiscard]] Json followDirectionsBy(const Candidate& anisotropy, const Candidate& directions);

[[nodiscard]] Json followFlow(const Candidate& flow, const std::string& speed);

[[nodiscard]] Json followUniform(const Candidate& vector);

/// Returns true if a flow has enough curl for vortexTube() or vortexDrag().
[[nodiscard]] bool hasVortices(const VectorAnalysis& flow);
/// Returns true if the flow turns like a rigid body where its curl is highest; shear layers do not.
[[nodiscard]] bool hasVortexCores(const VectorAnalysis& flow);
[[nodiscard]] Json vortexTube(const Candidate& flow);
/// Returns a drag that depends on the field `vorticity`.
[[nodiscard]] Json vortexDrag(const VectorAnalysis& flow, const std::string& vorticity);

}  // namespace palpate::guess
