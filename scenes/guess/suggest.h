/// Private to code that uses OpenVDB: the scene guess of guess.h, for OpenVDB grids.
#pragma once

#include <string>
#include <vector>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/guess/guess.h"
#include "palpate/scenes/guess/modality.h"

namespace palpate::guess {

/// A grid and known facts about it.
struct SuggestInput {
  /// Values of float, double, Vec3s or Vec3d; grids of other types are left out.
  openvdb::GridBase::ConstPtr grid;
  /// If `grid` is the x of a vector: the other components, with the same type; else null.
  openvdb::GridBase::ConstPtr y;
  openvdb::GridBase::ConstPtr z;
  std::string called;  ///< Name in the scene; empty: the grid's own name.
  Modality modality = Modality::kUnknown;
  std::string value_unit;  ///< "HU"; empty: unknown.
  bool axial = false;      ///< Vectors without a sign, such as the direction of fibres.
  bool apart = false;      ///< `y` or `z` have another transform: the vector cannot be analysed.
  /// True for an image: inactive voxels are its surroundings and have the background's value, and
  /// the boundary between air and skin may lie there. False for a mesh that was resampled: there is
  /// no data beyond the active voxels, and their edge is not a boundary.
  bool inactive_is_data = true;
  /// The voxels of an image. An object that is cut by the image's edge has no boundary there.
  /// Empty: unknown, the surroundings have no end.
  openvdb::CoordBBox extent;

  [[nodiscard]] bool isVector() const;
  [[nodiscard]] bool isScalar() const;
  /// Returns the name in the scene, else the name in the file.
  [[nodiscard]] std::string name() const { return called.empty() ? grid->getName() : called; }
};

/// Names of the metadata that the importer writes into a grid. With them a .vdb gets the same scene
/// as its import.
inline constexpr const char* kMetaImageSize = "image_size";  ///< Vec3i: voxels from 0, 0, 0 on.
inline constexpr const char* kMetaFrom = "imported_from";    ///< image, or mesh.
inline constexpr const char* kMetaModality = "modality";     ///< CT, or MR.
inline constexpr const char* kMetaAxial = "axial";           ///< bool

/// Returns a first scene for the grids of a file, as JSON text that a person can edit. The
/// description of each mode states how it was found. There are at most five modes in addition to
/// level sets, of 3.5 N at most. The scene's description names all omissions.
///
/// Each grid is analysed once (analysis.h). The rules of kind_rules.cpp decide on its kind, those
/// of choose_grids.cpp on its use, and those of mode_rules.cpp on its modes. A grid is one of
///
/// - a level set: isosurface at 0, for the first kMostLevelSets;
/// - CT in Hounsfield units, by the file's metadata, or by values of air and tissue at their places
///   on that scale: skin at -300, bone near 300, a drag in the soft tissue between;
/// - MR: the low surface of the skin, a drag by the signal;
/// - labels: whole numbers in constant pieces that touch in any order. An isosurface separates all
///   labels below it from all above it. So only the lowest and the highest label get a surface of
///   their own;
/// - the distance to a surface: isosurface at 0;
/// - fractions of materials, several grids that add up to 1: each material's surface at a half,
///   except for the material that surrounds the others;
/// - other scalars: up to three isosurfaces where the values change fastest, weakest outside. The
///   criterion is the mean gradient magnitude over each isosurface (Pekar, Wiemker and Hempel, Fast
///   detection of meaningful isosurfaces for volume data visualization, IEEE Visualization 2001).
///   It has dips at the values of materials and arches between them (Kindlmann and Durkin, IEEE
///   Volume Visualization 1998). The isovalue is the arch's middle. If no further material follows
///   (bone, for example, has any value up to the highest), the isovalue is where the arch has risen
///   by two thirds. Without an arch, the isovalue is that of a shock's front, where the isosurface
///   is steep nearly wherever it runs. A smooth field (a ramp, a temperature) has no boundary and
///   becomes a drag by its value. Difference to the papers: levels count where they pass between a
///   voxel's neighbours, not where a voxel has the value. So sharp steps are found as well,
///   although their middle is not the value of a voxel;
/// - directions, vectors without a sign, by the file's metadata or because all have length 1:
///   followed by anisotropy, if "..._direction" has its "..._anisotropy";
/// - a flow: follow, by speed; a drag by vorticity where it turns.
///
/// Throws VolumeError if no grid varies. Reads at most kSuggestSamples voxels per grid, in
/// parallel. Gradients are central differences per unit of the file. The axes of an affine map are
/// taken as orthogonal.
[[nodiscard]] Guess suggest(const GuessNames& names, const std::vector<SuggestInput>& grids,
                            GuessFor what = GuessFor::kAnything);

/// Returns only the scene of the guess, for a .vdb named as the scene shall name it.
[[nodiscard]] std::string suggestScene(const std::string& vdb_file,
                                       const std::vector<SuggestInput>& grids);

/// Number of voxels analysed per grid, spread evenly over its leaves.
constexpr std::size_t kSuggestSamples = 400'000;
/// Limit for one file; a scene can read 64 fields.
constexpr std::size_t kMostLevelSets = 32;

}  // namespace palpate::guess
