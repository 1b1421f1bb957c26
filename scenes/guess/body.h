/// Private to scene guesses and imports: separates the largest body of a CT from the table.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "palpate/scenes/guess/suggest.h"

namespace palpate::guess {

/// The largest body in an image of Hounsfield units.
struct LargestBody {
  /// 1 in the body and within two voxels of it; inactive elsewhere, and outside of the body within
  /// one voxel of another body. Its metadata name the image (kMetaBodyOf).
  openvdb::FloatGrid::Ptr region;
  std::uint64_t left = 0;  ///< Number of bodies left out.
};

/// Returns the name of LargestBody::region.
[[nodiscard]] inline std::string bodyNameOf(const std::string& image) {
  return image + "_body";
}

/// Key of the metadata of LargestBody::region that holds the image's name.
inline constexpr const char* kMetaBodyOf = "body_of";

/// Returns the largest body in an image of Hounsfield units: the largest set of face-connected
/// voxels above the value of the skin, and all smaller sets in its box, such as vessels in a lung.
/// All other sets, such as the table below a patient, are left out. Returns no value for other
/// units, for grids other than float, or if the background is above the value of the skin. Also
/// returns none if the sets to leave out have at most 1e-4 of the largest set's voxels. Cost: an
/// analysis of the image (analysis.h), and one pass over the box of the active voxels.
[[nodiscard]] std::optional<LargestBody> findLargestBody(const SuggestInput& image);

}  // namespace palpate::guess
