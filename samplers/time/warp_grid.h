/// Makes warps, which deform volumes, from displacement fields on a lattice. The fields come from
/// files or from memory.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/field/warp.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// The times of displacement fields.
struct WarpTimes {
  /// Times of the frames, ascending [s]. Not needed for a single frame.
  std::vector<double> times;
  bool repeat = false;  ///< If true, the warp repeats: the last frame must equal the first.
};

/// Displacement fields on a lattice of nodes in the volume's resting frame.
struct DisplacementFrames {
  std::array<int, 3> size{};     ///< Number of nodes along each axis, at least 2.
  Vec3 origin = Vec3::Zero();    ///< Position of node (0, 0, 0) [m].
  Mat3 axes = Mat3::Identity();  ///< Columns: steps to the next node along each axis [m].
  /// u [m]: for each frame, x, y and z of each node. The last axis varies fastest.
  std::vector<std::vector<float>> frames;
};

/// Largest memory of a warp [bytes].
inline constexpr std::uint64_t kMostWarpMemory = 1ULL << 30;
/// Throws SceneError at `path` if `frames` frames of a lattice of this size would need more memory
/// than kMostWarpMemory.
void checkWarpMemory(const std::array<int, 3>& size, std::size_t frames, const std::string& path);

/// Makes a warp from frames of displacements: X = x + u(x, t).
///
/// In space u is the quadratic B-spline through the nodes. Its slope is continuous, and its
/// curvature across the faces of the lattice is zero. Beyond the faces, u is that of the nearest
/// point on them. In time u is the cubic Hermite curve through the frames. Its slope at a frame is
/// that of the parabola through three frames, so the rate is continuous. Before the first frame and
/// after the last frame, u stays constant and its rate is zero, unless the warp repeats.
///
/// Throws SceneError, with `path` and the part with the error (/times/2), in these cases: there is
/// no frame; the number of times differs from that of the frames; times do not ascend; a repeated
/// warp does not end as it begins; a displacement is not finite; the warp needs more memory than
/// kMostWarpMemory; the warp folds space, or changes the lengths of material by a factor of more
/// than ten. The last condition is checked at all nodes and middles of cells, at all frames and at
/// the quarters of the intervals between them. Slow, parallel. Takes 32 bytes for each frame of
/// each node, where the lattice has one more node on each side, and about twice that during the
/// call. RT: at() reads 27 nodes.
[[nodiscard]] WarpPtr makeWarp(const DisplacementFrames& of, const WarpTimes& when,
                               const std::string& path);

/// Returns the displacements in vector volumes, one volume for each frame, all on one lattice. The
/// lattice is the box of their active voxels. If some voxels of the box are inactive, a margin of
/// one voxel of background is added. Vectors and axes are in the files' own unit of length; the
/// placement scales and rotates them. Throws SceneError at `path` for a volume that is not a vector
/// in one grid, or that has another lattice than the first.
[[nodiscard]] DisplacementFrames displacementsOf(
    std::span<const std::shared_ptr<const Volume>> frames, const Placement& placement,
    const std::string& path);

}  // namespace palpate
