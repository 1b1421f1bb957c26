/// Finds objects that a blend of two frames of a surface cannot move. An object that moves farther
/// than its own size between frames does not move in the blend: it fades out in one place and fades
/// in at another.
#pragma once

#include "palpate/engine/types.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Result of ghostsBetween. Specks, of fewer than eight voxels, are not counted in any of its
/// members.
struct Ghosts {
  int pieces = 0;             ///< Pieces of one frame that overlap no matter of the other.
  int of = 0;                 ///< All connected pieces of matter, both frames together.
  double share = 0.0;         ///< Share of matter (volume, both frames) in `pieces`, 0 to 1.
  Vec3 where = Vec3::Zero();  ///< Centre of volume of the largest of `pieces`, in the file's space;
                              ///< zero if `pieces` is 0. Of equal pieces, the first frame's.
  double size = 0.0;          ///< Its width: edge of a cube of its volume; the file's unit.
};

/// Splits the matter of two frames into connected pieces. Counts the pieces that overlap no matter
/// of the other frame, not even specks. Matter is where sign * (V - level) < 0: for a level set
/// level 0 and sign 1, for an isosurface felt from below sign -1. Only places with data count:
/// active voxels and tiles, and the whole inside of a level set (its inactive negative values).
/// Voxels belong to one piece if they share a face, an edge or a corner, so a slanting strand is
/// one piece.
///
/// The frames' voxels may differ in place and in size. Then pieces overlap if the centre of a voxel
/// of one is in a voxel of the other.
///
/// It does not find a part that moves too far while the rest of its piece stays, such as the tip of
/// a branch. It counts a piece that is new, or gone, as one that has moved.
///
/// @param sign  1 or -1.
/// Throws VolumeError for a volume that is not a scalar in one grid.
/// Tiles stay tiles: about 150 bytes for each tile, and for each connected part of a leaf. A ball
/// of 256 voxels across takes 0.1 s on one core, or 0.3 s if it is a ghost among other voxels. A
/// ball of 1200, with 1.8 million tiles, takes 3.5 and 13 s. Noise, 256^3 voxels in 73,000 pieces
/// and far more specks, takes 1.2 s.
[[nodiscard]] Ghosts ghostsBetween(const Volume& a, const Volume& b, double level, double sign);

/// Returns how much of a surface V = level of one frame is where the other frame has no data: the
/// greater of both frames' shares, 0 to 1. The surface is the active voxels that have a face
/// neighbour across the level. In the blend of the two frames, this part of the surface releases a
/// hand on it. Throws as ghostsBetween. Cost: seven reads per active voxel.
[[nodiscard]] double surfaceBeyondData(const Volume& a, const Volume& b, double level);

}  // namespace palpate
