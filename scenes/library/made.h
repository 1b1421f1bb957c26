/// Private to the program: procedural volumes. Examples use them if no file is at hand; tests
/// compare with them. They are deterministic: every machine and every run gives the same voxels, up
/// to the last digits of the mathematical library.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate {

/// Description of a volume that writeMade can make.
struct MadeVolume {
  std::string name;          ///< Name for writeMade.
  std::string what;          ///< Short description.
  std::string length_unit;   ///< Unit of the file's own space.
  double voxel = 0.0;        ///< Default edge of a voxel, in that unit.
  double least_voxel = 0.0;  ///< Finest voxel of writeMade, in that unit.
  double most_voxel = 0.0;   ///< Coarsest voxel of writeMade.
};

/// Returns all procedural volumes.
[[nodiscard]] const std::vector<MadeVolume>& madeVolumes();

/// Description of a written grid.
struct MadeGrid {
  std::string name;                 ///< Name in the file.
  std::string what;                 ///< Short description, as in its metadata.
  std::string value_unit;           ///< Unit, such as "m/s"; empty: without a unit.
  std::uint64_t active_voxels = 0;  ///< Number of active voxels, also in active tiles.
  double voxel = 0.0;               ///< Edge of a voxel, in MadeVolume::length_unit.
  int frames = 1;                   ///< Number of consecutive grids with that name: name[0],
                                    ///< name[1].
};

/// Makes a volume and writes it as a .vdb; its metadata hold palpate's version and the units.
/// @param voxel  Edge of a voxel in the volume's unit; unset: the default.
/// Throws Error if the name is unknown (the error suggests the nearest one), the voxel is out of
/// the volume's range, or the file cannot be written. A partial file then remains.
[[nodiscard]] std::vector<MadeGrid> writeMade(const std::string& name, std::optional<double> voxel,
                                              const std::filesystem::path& file);

/// Formulas, in the file's own space (_F).
namespace made {

/// Air flow about a wing in a wind tunnel. File: metres, x downstream, y along the wing, z up; the
/// wing is at the origin.
///
/// The flow is Prandtl's simplest wing: a uniform stream and one horseshoe vortex. The bound vortex
/// lies in the wing and lifts it. From the tips two vortices of opposite rotation trail downstream
/// to infinity. Each filament has the core of Rosenhead and Moore: 1/|r|^3 in the law of Biot and
/// Savart becomes 1/(|r|^2 + core^2)^(3/2). The velocity is then the curl of a vector potential, so
/// it has no divergence. About a long filament the velocity is circulation / (2 pi) r / (r^2 +
/// core^2), with the vorticity circulation / pi core^2 / (r^2 + core^2)^2. Not modelled: the wing's
/// thickness (air passes through it), the sheet behind it, the roll-up, the growth of the cores,
/// and the tunnel's walls.
struct Wind {
  double stream = 10.0;      ///< [m/s]
  double span = 0.3;         ///< Distance between the two vortices [m].
  double circulation = 1.0;  ///< [m^2/s]
  double core = 0.015;       ///< [m]

  [[nodiscard]] Vec3 velocity(const Vec3& p_F) const;  ///< [m/s]
};

/// Returns the signed distance to the wing [m], negative inside: a slab with round edges, pitched
/// by 6 degrees.
[[nodiscard]] double wing(const Vec3& p_F);

/// Diffusion imaging of two bundles of fibres that cross. File: mm.
///
/// One bundle is straight along x, the other bends in the plane z = 0; they cross at the origin at
/// a right angle. At every point the diffusion tensor is the mean of isotropic tissue and the
/// bundles, weighted by their shares. The tensor gives the direction of the greatest eigenvalue and
/// the fractional anisotropy (Basser & Pierpaoli 1996). The anisotropy is 0.80 in a bundle and 0
/// outside. It is 0.48 where both bundles have equal shares; no direction is greatest there.
struct Fibre {
  Vec3 direction = Vec3::Zero();  ///< Unit vector; its sign has no meaning. Zero outside the
                                  ///< bundles.
  double anisotropy = 0.0;        ///< 0 to 1.
};
[[nodiscard]] Fibre fibre(const Vec3& p_F);  ///< At p_F [mm]; all zero outside the bundles.

/// Returns the sign with which a voxel's direction is stored, +1 or -1: a hash of its index.
/// Eigenvectors of measured tensors have equally arbitrary signs.
[[nodiscard]] double signAt(int i, int j, int k);

/// Returns the signed distance to the surface of a bowl [mm]. The bowl is two thirds of a sphere
/// about the origin, open towards +z, with a wall of 6 mm and a round rim.
[[nodiscard]] double bowl(const Vec3& p_F);

/// Returns the density of a cloud in the bowl, through its wall and over its rim. The density is 1
/// near the cloud's centre and falls linearly to 0 at its edge. File: mm.
[[nodiscard]] double cloud(const Vec3& p_F);

/// Returns the signed distance to the surface of the left ventricle of a heart at rest, accurate
/// near the surface [mm]. It is an egg-shaped cup of muscle with a wall of 10 mm, open towards +z.
[[nodiscard]] double ventricle(const Vec3& p_F);
/// Returns the muscle's displacement u at a share of a beat, 0 to 1: the material at x rests at x +
/// u [mm]. The cavity narrows to two thirds, the wall thickens by a third, the apex (-z) rises, and
/// the cup twists by 15 degrees between apex and rim; then it rests. Not modelled: the exactly
/// constant volume of muscle, the right ventricle, blood.
[[nodiscard]] Vec3 beat(const Vec3& x_F, double share);

/// Returns the CT value of a trunk after breathing out: muscle (40) about two lungs (-800) and a
/// liver (60) under the diaphragm, air (-1000) outside. y points to the back, z to the head. File:
/// mm.
[[nodiscard]] double trunk(const Vec3& p_F);
/// Returns the trunk's displacement u at a share of a breath, 0 to 1: the material at x rests at x
/// + u [mm]. During inhalation the diaphragm moves down by up to 15 mm and the front of the chest
/// moves out by 6; the spine stays.
[[nodiscard]] Vec3 breath(const Vec3& x_F, double share);

}  // namespace made
}  // namespace palpate
