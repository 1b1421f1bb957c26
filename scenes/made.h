/// Private to the program: volumes made from formulas, what the examples feel where no file is at
/// hand, and what tests can compare with. Everything is deterministic: the same voxels on every
/// machine and in every run, to the last places of its mathematical library.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate {

/// A volume that writeMade can make.
struct MadeVolume {
  std::string name;          ///< As writeMade takes it.
  std::string what;          ///< In a few words.
  std::string length_unit;   ///< Of the file's own space.
  double voxel = 0.0;        ///< By default, in that unit.
  double least_voxel = 0.0;  ///< The finest that writeMade takes, in that unit,
  double most_voxel = 0.0;   ///< and the coarsest.
};

/// All of them.
[[nodiscard]] const std::vector<MadeVolume>& madeVolumes();

/// A grid as it was written.
struct MadeGrid {
  std::string name;                 ///< In the file.
  std::string what;                 ///< In a few words, as in its metadata.
  std::string value_unit;           ///< As "m/s"; empty for values without one.
  std::uint64_t active_voxels = 0;  ///< Active tiles counted by their voxels.
  double voxel = 0.0;               ///< Edge of its cubes, in MadeVolume::length_unit.
  int frames = 1;                   ///< Grids of that name one after the other: name[0], name[1].
};

/// Makes a volume and writes it as a .vdb; its metadata say by which version, and of what unit.
/// @param voxel  In the volume's unit; none: the default.
/// Throws Error for another name (the nearest is suggested), for a voxel out of the volume's range,
/// and where the file cannot be written: then what there is of it is left.
[[nodiscard]] std::vector<MadeGrid> writeMade(const std::string& name, std::optional<double> voxel,
                                              const std::filesystem::path& file);

/// The formulas, in the file's own space (_F).
namespace made {

/// Air about a wing in a tunnel. File: metres, x downstream, y along the wing, z up; the wing is at
/// the origin.
///
/// The flow is Prandtl's simplest wing: a uniform stream and one horseshoe vortex. Its bound part
/// lies in the wing and lifts it, its ends leave the tips downstream for ever as two vortices that
/// turn against each other. Each filament has the core of Rosenhead and Moore: 1/|r|^3 in the law
/// of Biot and Savart becomes 1/(|r|^2 + core^2)^(3/2). The velocity is then the curl of a vector
/// potential, so that it has no divergence at all; about a long filament it is
/// circulation / (2 pi) r / (r^2 + core^2), with the vorticity
/// circulation / pi core^2 / (r^2 + core^2)^2.
/// Left out: the wing's thickness (air passes through it), the sheet behind it, the roll-up, the
/// growth of the cores, and the tunnel's walls.
struct Wind {
  double stream = 10.0;      ///< [m/s]
  double span = 0.3;         ///< Between the two vortices [m].
  double circulation = 1.0;  ///< [m^2/s]
  double core = 0.015;       ///< [m]

  [[nodiscard]] Vec3 velocity(const Vec3& p_F) const;  ///< [m/s]
};

/// Signed distance to the wing, a slab with round edges, pitched by 6 degrees [m]; negative inside.
[[nodiscard]] double wing(const Vec3& p_F);

/// What diffusion imaging shows of two bundles of fibres that cross. File: mm.
///
/// One bundle runs straight along x, the other bends round in the plane z = 0; they cross at the
/// origin at a right angle. In every place the diffusion tensor is the mean of isotropic tissue and
/// of the bundles, by their share. Of it come the direction of the greatest eigenvalue and the
/// fractional anisotropy (Basser & Pierpaoli 1996): 0.80 in a bundle, 0.48 where two share a place
/// equally and no direction is greatest, 0 outside.
struct Fibre {
  Vec3 direction = Vec3::Zero();  ///< Unit, its sign means nothing; zero outside the bundles.
  double anisotropy = 0.0;        ///< 0 to 1.
};
[[nodiscard]] Fibre fibre(const Vec3& p_F);  ///< At p_F [mm]; all zero outside the bundles.

/// The sign that a voxel's direction is stored with, +1 or -1: a hash of its index. Eigenvectors of
/// measured tensors come with signs as arbitrary.
[[nodiscard]] double signAt(int i, int j, int k);

/// A bowl, open towards +z, two thirds of a sphere about the origin with a wall of 6 mm and a round
/// rim: signed distance to its surface [mm].
[[nodiscard]] double bowl(const Vec3& p_F);

/// A cloud in the bowl, through its wall and over its rim: its density is 1 near its centre and
/// falls off along a straight ramp to 0 at its edge. File: mm.
[[nodiscard]] double cloud(const Vec3& p_F);

/// The left ventricle of a heart at rest, an egg-shaped cup of muscle with a wall of 10 mm, open
/// towards +z: signed distance to its surface, near it [mm].
[[nodiscard]] double ventricle(const Vec3& p_F);
/// How the muscle has moved at a share of a beat, 0 to 1: what is at x rests at x + u [mm]. The
/// cavity narrows to two thirds, the wall thickens by a third, the apex (-z) comes up, and the cup
/// wrings by 15 degrees between apex and rim; then it rests. Left out: that muscle keeps its volume
/// exactly, the right ventricle, blood.
[[nodiscard]] Vec3 beat(const Vec3& x_F, double share);

/// A trunk as CT shows it, breathed out: muscle (40) about two lungs (-800) and a liver (60) under
/// the diaphragm, air (-1000) outside. y to the back, z to the head. File: mm.
[[nodiscard]] double trunk(const Vec3& p_F);
/// How it has moved at a share of a breath, 0 to 1: what is at x rests at x + u [mm]. Breathing in,
/// the diaphragm goes down by up to 15 mm and the chest's front comes out by 6; the spine stays.
[[nodiscard]] Vec3 breath(const Vec3& x_F, double share);

}  // namespace made
}  // namespace palpate
