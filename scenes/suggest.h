/// Private to what knows OpenVDB: a first scene for grids, as guess.h tells of it.
#pragma once

#include <string>
#include <vector>

#include "palpate/samplers/openvdb_grids.h"
#include "palpate/scenes/guess.h"
#include "palpate/scenes/modality.h"

namespace palpate::guess {

/// What is known of a grid beside its values.
struct SuggestInput {
  openvdb::GridBase::ConstPtr grid;  ///< Of floats or doubles, or vectors of these; others are left
                                     ///< out.
  openvdb::GridBase::ConstPtr y;     ///< Where `grid` is the x of a vector its others, of its type
  openvdb::GridBase::ConstPtr z;     ///< and transform; else null.
  std::string called;                ///< As a scene names it; empty: by the grid's own name.
  Modality modality = Modality::kUnknown;
  std::string value_unit;  ///< "HU"; empty: unknown.
  bool axial = false;      ///< Vectors without a sign, as a fibre's direction.
  bool apart = false;      ///< `y` or `z` have another transform: they cannot be looked at.
  /// An image's: inactive voxels are its surroundings, their value is the background's, and the
  /// boundary between air and skin may lie there. False for a mesh that was resampled: there is no
  /// data beyond the active voxels, and their edge is no boundary.
  bool inactive_is_data = true;
  /// An image's voxels: where an object is cut by the image's edge, that is no boundary either.
  /// Empty: not known, the surroundings have no end.
  openvdb::CoordBBox extent;

  [[nodiscard]] bool isVector() const;
  [[nodiscard]] bool isScalar() const;
  /// As the scene names it, else as the file does.
  [[nodiscard]] std::string name() const { return called.empty() ? grid->getName() : called; }
};

/// The names of what the importer writes into a grid's metadata, by which a .vdb gets the scene
/// that its import got.
inline constexpr const char* kMetaImageSize = "image_size";  ///< Vec3i: voxels from 0, 0, 0 on.
inline constexpr const char* kMetaFrom = "imported_from";    ///< image, or mesh.
inline constexpr const char* kMetaModality = "modality";     ///< CT, or MR.
inline constexpr const char* kMetaAxial = "axial";           ///< bool

/// A first scene for the grids of a file, as JSON text that a person can edit; every mode says in
/// its description how it was found. Beside level sets at most five modes, of 3.5 N at most; what
/// was left out is named in the scene's description.
///
/// Each grid is looked at once (look.h) and is then one of
///
/// - a level set: isosurface at 0, of the first kMostLevelSets;
/// - CT in Hounsfield units, said by the file, or seen by air and tissue where that scale has them:
///   skin at -300, bone near 300, a drag in the soft tissue between;
/// - MR: the low surface of the skin, a drag by the signal;
/// - labels: whole numbers in constant pieces that touch in any order. An isosurface tells all
///   labels below it from all above, so that only the lowest and the highest have one of their own;
/// - fractions of materials, several grids that add up to 1: the surface of each at a half, but of
///   that which surrounds the others;
/// - other scalars: up to three isosurfaces where the values change fastest, weakest outside. The
///   criterion is the mean gradient magnitude over each isosurface (Pekar, Wiemker and Hempel, Fast
///   detection of meaningful isosurfaces for volume data visualization, IEEE Visualization 2001):
///   it has dips at the values of materials and arches between them (Kindlmann and Durkin, IEEE
///   Volume Visualization 1998). The isovalue is the arch's middle; where no further material
///   follows (bone, whose values have no end) it is where the arch has risen. Where there are no
///   arches, a shock's front: the value whose isosurface is steep wherever it runs. A field that is
///   smooth (a ramp, a temperature) has no boundary and becomes a drag by its value.
///   Departure: levels are counted where they pass between a voxel's neighbours, not where a voxel
///   has the value, so that sharp steps, whose middle no voxel has, are found as well;
/// - directions, vectors without a sign, by the file or because all have length 1: followed by
///   anisotropy, where "..._direction" has its "..._anisotropy";
/// - a flow: follow, by speed; a drag by vorticity where it turns.
///
/// Throws VolumeError where nothing varies. Reads at most kSuggestSamples voxels a grid, in
/// parallel; gradients are central differences per unit of the file, and an affine map's axes are
/// taken as orthogonal.
[[nodiscard]] Guess suggest(const GuessNames& names, const std::vector<SuggestInput>& grids,
                            GuessFor what = GuessFor::kAnything);

/// Its scene alone, of a .vdb as the scene shall say it.
[[nodiscard]] std::string suggestScene(const std::string& vdb_file,
                                       const std::vector<SuggestInput>& grids);

/// Voxels looked at a grid, spread evenly over its leaves.
constexpr std::size_t kSuggestSamples = 400'000;
/// Of one file; a scene can read 64 fields.
constexpr std::size_t kMostLevelSets = 32;

}  // namespace palpate::guess
