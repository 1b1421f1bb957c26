/// Private to scene guesses and imports: separates the largest body of a CT from the table.
#pragma once

#include <cstdint>
#include <optional>

#include "palpate/scenes/guess/suggest.h"

namespace palpate::guess {

/// The largest body in an image of Hounsfield units.
struct LargestBody {
  /// Value 1 in the body and within two voxels of it, but not within one voxel of what is left out;
  /// inactive elsewhere. Its metadata name the image (kMetaBodyOf).
  openvdb::FloatGrid::Ptr region;
  std::uint64_t left = 0;  ///< Number of bodies that are left out.
};

/// Name of the metadata of LargestBody::region: the name of the image.
inline constexpr const char* kMetaBodyOf = "body_of";

/// Returns the largest body in an image of Hounsfield units: the largest set of voxels above the
/// value of the skin that are connected by their faces, with all smaller sets in its box, such as
/// vessels in a lung. All other sets are left out, such as the table below a patient. Returns no
/// value if the image has other units, or if nothing is left out.
///
/// Cost: one pass over the box of the active voxels, and some 50 bytes for each run of voxels along
/// z.
[[nodiscard]] std::optional<LargestBody> findLargestBody(const SuggestInput& image);

}  // namespace palpate::guess
