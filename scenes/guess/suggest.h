/// Private to code that uses OpenVDB: the scene guess (guess.h) for OpenVDB grids.
#pragma once

#include <string>
#include <vector>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/guess/guess.h"
#include "palpate/scenes/guess/modality.h"

namespace palpate::guess {

struct SuggestInput {
  /// A grid of float, double, Vec3s or Vec3d. Grids of other types are left out of the scene.
  openvdb::GridBase::ConstPtr grid;
  /// Other components of a vector whose x component is `grid`, of the same type; else null.
  openvdb::GridBase::ConstPtr y;
  openvdb::GridBase::ConstPtr z;
  std::string called;  ///< Name of the grid in the scene; empty: the grid's own name.
  Modality modality = Modality::kUnknown;
  std::string value_unit;  ///< Unit of the values, such as "HU"; empty: unknown.
  bool axial = false;      ///< True if vectors v and -v mean the same, as for fibres.
  bool bricks = false;     ///< True for a volume in bricks, in which modes cannot select labels.
  /// True if `y` or `z` has another transform than `grid`; then the vector is not analysed.
  bool apart = false;
  /// True for an image: its inactive voxels have the value of the background, and the edge of the
  /// active voxels may be a boundary such as skin. False for a resampled mesh: its inactive voxels
  /// are outside of the data.
  bool inactive_is_data = true;
  /// Box of an image's voxels; where it cuts an object, there is no boundary. Empty: unknown.
  openvdb::CoordBBox extent;

  [[nodiscard]] bool isVector() const;
  [[nodiscard]] bool isScalar() const;
  /// Returns `called`, or the name of the grid if `called` is empty.
  [[nodiscard]] std::string name() const { return called.empty() ? grid->getName() : called; }
};

/// Keys of metadata by which a guess for the .vdb gives the same scene as the guess at import.
inline constexpr const char* kMetaImageSize =
    "image_size";  ///< Vec3i: number of voxels along each axis, from voxel 0, 0, 0 on.
inline constexpr const char* kMetaModality = "modality";  ///< "CT" or "MR".
/// bool: vectors v and -v mean the same.
inline constexpr const char* kMetaAxial = "axial";

/// Returns a first scene for the grids of a file, as JSON text that a person can edit. The
/// descriptions explain the values and name all omissions. Besides level sets, there are at most
/// five modes. All strengths are at most 3.5 N.
///
/// Each grid is analysed once (analysis.h). kind_rules.cpp determines its kind, choose_grids.cpp
/// its use, and mode_rules.cpp its modes:
///
/// - a level set: an isosurface at 0, for the first kMostLevelSets;
/// - CT in Hounsfield units, stated by the file's metadata or suggested by the values of air and
///   tissue: the skin at -300, bone near 300, and a drag in the soft tissue between them;
/// - MR: the surface of the skin at a low value, and a drag that depends on the signal;
/// - labels that the metadata state, as those of a segmentation: the surface of each of the largest
///   labels, as far as modes are free (at most four of one grid);
/// - other labels: whole numbers in constant regions, in which any two labels can be neighbours. An
///   isosurface separates all labels below it from all labels above it, so only the lowest and the
///   highest label get a surface;
/// - the distance to a surface: an isosurface at 0. Its solid is below 0, unless more than three
///   quarters of the values on the box's faces are below 0. Weights of distances are left out;
/// - fractions of materials, which are several grids with the sum 1: a surface at one half for each
///   material, except for the outermost one. Grids with the names of volume fractions may add up to
///   less than 1: the rest is a void. Masses are left out;
/// - other scalars: up to three isosurfaces where the values change fastest, the outer ones weaker
///   than the inner ones, and a weak drag within them. The criterion is the mean gradient magnitude
///   over each isosurface (Pekar, Wiemker and Hempel, Fast detection of meaningful isosurfaces for
///   volume data visualization, IEEE Visualization 2001). It has dips at the values of materials
///   and arches between them (Kindlmann and Durkin, IEEE Volume Visualization 1998). The isovalue
///   is the middle of the arch. With a material on one side only, the isovalue is where the arch
///   has risen by two thirds. Without an arch, the isovalue is that of a front (findFront). A
///   smooth field has no boundary and gets a drag that depends on its value. Unlike in the papers,
///   a level counts where it lies between the values of a voxel's neighbours. Therefore sharp steps
///   are found too;
/// - directions: vectors that have no sign by the file's metadata, all have length 1, or are fibres
///   by --for: a mode that follows them. If "..._direction" has a grid "..._anisotropy" or
///   "..._fa", the strength of the mode depends on the anisotropy;
/// - a flow: a mode that follows it, with a strength that depends on the speed. If it has vortices,
///   also a vortex tube; if it only shears, a drag that depends on the vorticity.
///
/// Throws VolumeError if no grid is usable, for example if all are constant scalars. Analyses about
/// kSuggestSamples voxels of each grid, in parallel. Gradients are central differences per unit of
/// the file. The axes of an affine transform are treated as orthogonal.
[[nodiscard]] Guess suggest(const GuessNames& names, const std::vector<SuggestInput>& grids,
                            GuessFor what = GuessFor::kAnything);

/// Returns the name of a grid's volume in a guessed scene. Only letters, digits and hyphens stay:
/// other characters become "_" if they are between these, one for each run, and are dropped at the
/// ends. If an earlier grid has this name, the scene adds "_2" and so on.
[[nodiscard]] std::string volumeNameOf(const std::string& grid);

/// Returns the JSON of the guessed scene, with the path `vdb_file`.
[[nodiscard]] std::string suggestScene(const std::string& vdb_file,
                                       const std::vector<SuggestInput>& grids);

/// Approximate limit of the number of voxels that are analysed in a grid. They are spread evenly
/// over its leaves and tiles.
constexpr std::size_t kSuggestSamples = 400'000;
/// Largest number of level sets that are used from one file; a scene can read 64 fields.
constexpr std::size_t kMostLevelSets = 32;

}  // namespace palpate::guess
