/// Private to scene guesses and imports: separates the largest body of a CT from the table.
#pragma once

#include <cstdint>
#include <optional>

#include "palpate/scenes/guess/suggest.h"

namespace palpate::guess {

/// The largest body in an image of Hounsfield units.
struct LargestBody {
  /// 1 in the body and within two voxels of it; inactive elsewhere, and within one voxel of other
  /// bodies. Its metadata name the image (kMetaBodyOf).
  openvdb::FloatGrid::Ptr region;
  std::uint64_t left = 0;  ///< Number of bodies that are left out.
};

/// Name of the metadata of LargestBody::region: the name of the image.
inline constexpr const char* kMetaBodyOf = "body_of";

/// Returns the largest body in an image of Hounsfield units: the largest set of voxels above the
/// value of the skin that are connected by their faces, with all smaller sets in its box, such as
/// vessels in a lung. Leaves out all other sets, such as the table below a patient. Returns no
/// value for other units, or if at most 1e-4 of the largest set's voxels would be left out. Cost:
/// one pass over the box of the active voxels, and some 50 bytes for each run along z.
[[nodiscard]] std::optional<LargestBody> findLargestBody(const SuggestInput& image);

}  // namespace palpate::guess
