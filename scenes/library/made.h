/// Private to the program: volumes that are computed from formulas, for examples without a file and
/// for tests. All machines compute equal volumes, except for the last digits of mathematical
/// functions.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate {

/// Description of a volume that writeMade() can make. The edges are those of the first grid's
/// voxels; other grids may have other edges.
struct MadeVolume {
  std::string name;          ///< Name of the volume, for writeMade().
  std::string what;          ///< Short description.
  std::string length_unit;   ///< Unit of length in the file.
  double voxel = 0.0;        ///< Default edge of a voxel, in the unit of length.
  double least_voxel = 0.0;  ///< Smallest allowed edge of a voxel, in the unit of length.
  double most_voxel = 0.0;   ///< Largest allowed edge of a voxel, in the unit of length.
};

/// Returns the descriptions of all volumes.
[[nodiscard]] const std::vector<MadeVolume>& madeVolumes();

/// Description of a grid that was written.
struct MadeGrid {
  std::string name;        ///< Name of the grid in the file.
  std::string what;        ///< Short description, which is also in the metadata of the grid.
  std::string value_unit;  ///< Unit of the values, such as "m/s"; empty: they have no unit.
  std::uint64_t active_voxels = 0;  ///< Number of active voxels, including those in active tiles.
  double voxel = 0.0;               ///< Edge of a voxel, in MadeVolume::length_unit.
  int frames = 1;  ///< Number of grids with this name; if above 1: name[0], name[1] and so on.
};

/// Computes a volume and writes it as a .vdb, with palpate's version and the units. `voxel` is the
/// edge of a voxel of the first grid, in MadeVolume::length_unit; unset: MadeVolume::voxel. Throws
/// Error if the name is unknown, if the edge is out of range, or if the file cannot be written. A
/// failed write may leave an incomplete file.
[[nodiscard]] std::vector<MadeGrid> writeMade(const std::string& name, std::optional<double> voxel,
                                              const std::filesystem::path& file);

/// The formulas. Positions are in the space of the file (_F).
namespace made {

/// Air flow around a wing in a wind tunnel. File: metres, x downstream, y along the wing, z up,
/// with the wing at the origin.
///
/// The model is Prandtl's simplest: a uniform stream and a horseshoe vortex. The bound vortex is in
/// the wing and produces the lift. From each tip, a vortex trails downstream to infinity; the two
/// rotate in opposite directions. The cores follow Rosenhead and Moore: in the law of Biot and
/// Savart, 1/|r|^3 becomes 1/(|r|^2 + core^2)^(3/2). The velocity is the curl of a vector
/// potential, so it has no divergence. Around a long filament, the velocity is circulation / (2 pi)
/// r / (r^2 + core^2), and the vorticity is circulation / pi core^2 / (r^2 + core^2)^2. Not
/// modelled: the wing's thickness (air passes through the wing), the vortex sheet, the growth of
/// the cores, and the tunnel's walls.
struct Wind {
  double stream = 10.0;      ///< Speed of the uniform stream [m/s].
  double span = 0.3;         ///< Distance between the two trailing vortices [m].
  double circulation = 1.0;  ///< Circulation of the vortices [m^2/s].
  double core = 0.015;       ///< Radius of the vortex cores [m].

  /// Returns the velocity of the air at p_F [m/s].
  [[nodiscard]] Vec3 velocity(const Vec3& p_F) const;
};

/// Returns the signed distance to the wing [m], negative inside. The wing is a flat box with round
/// edges, pitched by 6 degrees.
[[nodiscard]] double wing(const Vec3& p_F);

/// Diffusion imaging of two bundles of fibres that cross at a right angle at the origin. File: mm.
///
/// One bundle is straight along x; the other is bent in the plane z = 0. At each point, the
/// diffusion tensor is the mean of isotropic tissue and the bundles, weighted by their shares. The
/// share of a bundle is 1 up to 6 mm from its axis, and falls to 0 at 9 mm. The anisotropy (Basser
/// & Pierpaoli 1996) is 0.80 in the core of a single bundle, falls towards its edge, and is 0
/// outside. At the origin both bundles have their full shares: the anisotropy is 0.48 there, and
/// two directions have the greatest eigenvalue.
struct Fibre {
  /// Unit eigenvector of the greatest eigenvalue, with either sign; zero outside the bundles.
  Vec3 direction = Vec3::Zero();
  double anisotropy = 0.0;  ///< Fractional anisotropy, 0 to 1.
};
/// Returns the fibre at p_F [mm].
[[nodiscard]] Fibre fibre(const Vec3& p_F);

/// Returns the sign of the stored direction of a voxel, +1 or -1. The sign is a hash of the voxel's
/// index, because eigenvectors of measured tensors have arbitrary signs too.
[[nodiscard]] double signAt(int i, int j, int k);

/// Returns the signed distance to a bowl's surface [mm]: a spherical wall around the origin, 6 mm
/// thick, open within 60 degrees of +z, with a round rim.
[[nodiscard]] double bowl(const Vec3& p_F);

/// Returns the density of a cloud that extends beyond the bowl: 1 near the cloud's centre, then
/// linearly down to 0 at its edge. File: mm.
[[nodiscard]] double cloud(const Vec3& p_F);

/// Returns the signed distance to the left ventricle of a heart at rest [mm], accurate near the
/// surface. The ventricle is an egg-shaped cup of muscle with a wall of 10 mm, open towards +z.
[[nodiscard]] double ventricle(const Vec3& p_F);
/// Returns the displacement u of the muscle at a fraction `share` of a beat, 0 to 1: the material
/// at x is at x + u at rest [mm]. At its widest section, the cavity narrows to about two thirds and
/// the wall becomes about half thicker. The apex (-z) rises, and the cup twists by about 13
/// degrees. Then the muscle relaxes. Not modelled: the constant volume of muscle, the right
/// ventricle, and the blood.
[[nodiscard]] Vec3 beat(const Vec3& x_F, double share);

/// Returns the CT value of a trunk after breathing out [HU]: muscle (40) around two lungs (-800), a
/// liver (60) below the diaphragm, and air (-1000) outside. File: mm, y to the back, z to the head.
[[nodiscard]] double trunk(const Vec3& p_F);
/// Returns the displacement u of the trunk at a fraction `share` of a breath, 0 to 1: the material
/// at x is at x + u at rest [mm]. On inhalation, the diaphragm moves down by up to 15 mm, and the
/// front of the chest forward by up to 6 mm.
[[nodiscard]] Vec3 breath(const Vec3& x_F, double share);

}  // namespace made
}  // namespace palpate
