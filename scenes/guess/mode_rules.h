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

/// Returns at most `most` modes for a scalar, the most important ones first. The scalar must be
/// neither constant nor a level set.
[[nodiscard]] std::vector<Json> scalarModes(const Candidate& c, std::size_t most);

/// Returns an isosurface at 0, for a level set.
[[nodiscard]] Json levelSetSurface(const Candidate& c);

/// Returns an isosurface of a material's fraction. `share` is the material's fraction of the whole
/// volume, 0 to 1.
[[nodiscard]] Json materialSurface(const Candidate& c, double share);

/// Return a mode that follows directions. Its strength depends on the lengths of the vectors, or on
/// a measure of anisotropy.
[[nodiscard]] Json followDirections(const Candidate& directions);
[[nodiscard]] Json followDirectionsBy(const Candidate& anisotropy, const Candidate& directions);

/// Returns a mode that follows a flow. Its strength depends on the field `speed`.
[[nodiscard]] Json followFlow(const Candidate& flow, const std::string& speed);

/// Returns a mode that follows a vector which is the same everywhere.
[[nodiscard]] Json followUniform(const Candidate& vector);

/// Returns true if a flow has enough curl for the mode of vortexDrag().
[[nodiscard]] bool hasVortices(const VectorAnalysis& flow);
/// Returns true if the flow turns like a solid where its curl is highest, as in the core of a
/// vortex. In a shear layer, such as the wake of a wall, the flow only shears.
[[nodiscard]] bool hasVortexCores(const VectorAnalysis& flow);
/// Returns a mode that guides the hand along the vortices of a flow.
[[nodiscard]] Json vortexTube(const Candidate& flow);
/// Returns a drag that depends on the vorticity of a flow, the field with the given name.
[[nodiscard]] Json vortexDrag(const VectorAnalysis& flow, const std::string& vorticity);

}  // namespace palpate::guess
