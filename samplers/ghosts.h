/// What a blend of two frames of a surface cannot show: a thing that moves farther than its own
/// size from one to the next. It does not move there, it fades out in one place and in at another.
#pragma once

#include "palpate/engine/types.h"
#include "palpate/samplers/volume.h"

namespace palpate {

/// What ghostsBetween found. Specks, of fewer than eight voxels, are left out of all of it.
struct Ghosts {
  int pieces = 0;             ///< Of one frame, and of the other frame's matter nothing is there,
  int of = 0;                 ///< of so many connected pieces of matter, both frames together.
  double share = 0.0;         ///< Of the matter's volume (both frames) in such pieces, 0 to 1.
  Vec3 where = Vec3::Zero();  ///< The largest such piece's centre of volume, in the file's space;
                              ///< zero if none. Of equal ones the first frame's.
  double size = 0.0;          ///< Its width, the edge of a cube of its volume; the file's unit.
};

/// Takes the matter of two frames apart into connected pieces, and counts those that overlap no
/// matter of the other frame, speck or not. Matter is where sign * (V - level) < 0: of a level set
/// level 0 and sign 1, of an isosurface felt from below sign -1. Only where there are data: active
/// voxels and tiles, and all of a level set's inside (its inactive negative values). Voxels are of
/// one piece where they share a face, an edge or a corner: a slanting strand is one.
///
/// The frames' voxels need not be at the same places, nor of one size: then pieces overlap where
/// the centre of a voxel of one is in a voxel of the other.
///
/// What this cannot see: a part that moves too far while the rest of its piece stays, such as the
/// tip of a branch. A piece that is new, or gone, is counted as one that has moved.
///
/// @param sign  1 or -1.
/// Throws VolumeError for a volume that is no scalar in one grid.
/// Tiles stay tiles: about 150 bytes for each of them, and for each connected part of a leaf. A
/// ball of 256 voxels across takes 0.1 s on one core, 0.3 s where it is a ghost among other voxels;
/// one of 1200, with 1.8 million tiles, 3.5 and 13 s; noise, 256^3 voxels in 73,000 pieces and far
/// more specks, 1.2 s.
[[nodiscard]] Ghosts ghostsBetween(const Volume& a, const Volume& b, double level, double sign);

/// How much of a surface V = level of one frame is where the other has no data: the greater of both
/// frames' shares, 0 to 1, of the active voxels that have a neighbour, by a face, across the level.
/// A surface that a hand is on lets go of it in the blend of two such frames. Throws as
/// ghostsBetween. Cost: seven reads a voxel that is active.
[[nodiscard]] double surfaceBeyondData(const Volume& a, const Volume& b, double level);

}  // namespace palpate
