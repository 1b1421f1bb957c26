/// A first scene for what was imported: something to feel at once, and to edit.
#pragma once

#include <string>
#include <vector>

#include "palpate/samplers/openvdb_grids.h"
#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// What is known of a grid beside its values.
struct SuggestInput {
  openvdb::GridBase::ConstPtr grid;  ///< FloatGrid or Vec3SGrid, named; others are left out.
  Modality modality = Modality::kUnknown;
  std::string value_unit;  ///< "HU"; empty: unknown.
  bool axial = false;      ///< Vectors without a sign, as a fibre's direction.
  /// An image's: inactive voxels are its surroundings, their value is the background's, and the
  /// boundary between air and skin may lie there. False for a mesh that was resampled: there is no
  /// data beyond the active voxels, and their edge is no boundary.
  bool inactive_is_data = true;
  /// An image's voxels: where an object is cut by the image's edge, that is no boundary either.
  /// Empty: not known, the surroundings have no end.
  openvdb::CoordBBox extent;
};

/// A first scene for the grids of a file, as JSON text that a person can edit; every mode says in
/// its description how it was found. At most five modes, of 3.5 N at most; what was left out is
/// named in the scene's description.
///
/// - Level set: isosurface at 0.
/// - CT in Hounsfield units: skin at -300, bone near 300, a drag in the soft tissue between.
/// - Other scalars: up to three isosurfaces where the values change fastest, weakest outside. The
///   criterion is the mean gradient magnitude over each isosurface (Pekar, Wiemker and Hempel, Fast
///   detection of meaningful isosurfaces for volume data visualization, IEEE Visualization 2001):
///   it has dips at the values of materials and arches between them (Kindlmann and Durkin, IEEE
///   Volume Visualization 1998). The isovalue is the arch's middle; where no further material
///   follows (bone, whose values have no end) it is where the arch has risen. A field whose arch is
///   wide in space (a ramp, a temperature) has no boundary and becomes a drag by its value.
///   Departure: levels are counted where they pass between a voxel's neighbours, not where a voxel
///   has the value, so that sharp steps, whose middle no voxel has, are found as well.
/// - Vectors: follow, by speed; a drag by vorticity where the flow turns; axial ones by anisotropy,
///   where "..._direction" has its "..._anisotropy".
///
/// @param vdb_file  As the scene shall say it, relative to the scene.
/// @return          JSON, indented by 2. The same for the same grids, whatever the threads.
///
/// Throws VolumeError where nothing varies. Reads at most kSuggestSamples voxels a grid, in
/// parallel; gradients are central differences per unit of the file, and an affine map's axes are
/// taken as orthogonal.
[[nodiscard]] std::string suggestScene(const std::string& vdb_file,
                                       const std::vector<SuggestInput>& grids);

/// Voxels looked at a grid, spread evenly over its leaves.
constexpr std::size_t kSuggestSamples = 400'000;

}  // namespace palpate::importer
