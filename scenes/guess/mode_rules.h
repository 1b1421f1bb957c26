/// Private to the scene guess: the modes of each kind of grid, with their strengths and reasons.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "palpate/scenes/guess/candidate.h"
#include "palpate/scenes/guess/scene_json.h"

namespace palpate::guess {

/// Returns the modes of a scalar, at most `most`, important ones first. The scalar is neither
/// constant nor a level set.
[[nodiscard]] std::vector<Json> scalarModes(const Candidate& c, std::size_t most);

/// Returns the isosurface at 0 of a level set.
[[nodiscard]] Json levelSetSurface(const Candidate& c);

/// Returns the isosurface of a material's fraction. `share` is its part of the volume: 0 to 1.
[[nodiscard]] Json materialSurface(const Candidate& c, double share);

/// Return a follow mode along directions: by their own lengths, or by a measure of anisotropy.
[[nodiscard]] Json followDirections(const Candidate& directions);
[[nodiscard]] Json followDirectionsBy(const Candidate& anisotropy, const Candidate& directions);

/// Returns a follow mode along a flow, by the field of its speed.
[[nodiscard]] Json followFlow(const Candidate& flow, const std::string& speed);

/// Returns a follow mode along a vector that is the same everywhere.
[[nodiscard]] Json followUniform(const Candidate& vector);

/// Returns true if a flow has enough curl for vortexDrag().
[[nodiscard]] bool hasVortices(const VectorAnalysis& flow);
/// Returns a drag by the field of a flow's vorticity.
[[nodiscard]] Json vortexDrag(const VectorAnalysis& flow, const std::string& vorticity);

}  // namespace palpate::guess
