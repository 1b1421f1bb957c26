/// Makes warps, which deform volumes, from displacement fields on a lattice.
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
  /// If true, the warp repeats. The last frame must equal the first to within 1e-4 of the largest
  /// displacement.
  bool repeat = false;
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
/// Throws SceneError at `path` if this lattice and number of frames exceed kMostWarpMemory.
void checkWarpMemory(const std::array<int, 3>& size, std::size_t frames, const std::string& path);

/// Makes a warp from frames of displacements: X = x + u(x, t).
///
/// In space u is the quadratic B-spline through the nodes. Its slope is continuous, and its
/// curvature across the lattice's faces is zero. Beyond the faces, u is that of the point on them
/// with clamped indices. In time u is the cubic Hermite curve through the frames, with slopes of
/// parabolas through three frames: the rate is continuous. At the first and last frame of a warp
/// that does not repeat, the slope is zero. In a frame between uneven intervals the slope is
/// limited, so that u does not overshoot there. Outside of the frames' times, u is constant, or
/// repeats.
///
/// Throws SceneError, with `path` and the faulty part (/times/2), in these cases. There is no
/// frame. Times do not ascend, are not within +-1e9 s, or differ in number from the frames. The
/// lattice has fewer than two nodes along an axis. A repeated warp has one frame, or does not end
/// as it begins. A displacement is not finite. The warp needs more memory than kMostWarpMemory. The
/// warp folds space, or stretches or compresses by a factor above ten; this is checked at nodes and
/// middles of cells, at frames and at the quarters between them. Slow, parallel. Needs 32 bytes of
/// memory per node and frame, with one more node on each side, and up to twice that during the
/// call. RT: at() reads 27 nodes.
[[nodiscard]] WarpPtr makeWarp(const DisplacementFrames& of, const WarpTimes& when,
                               const std::string& path);

/// Returns the displacements in vector volumes, one for each frame. Their lattice is the box of the
/// active voxels, with a margin of one voxel of background if some voxels in it are inactive. The
/// placement scales and rotates vectors and axes, which are in the files' unit of length. Throws
/// SceneError at `path` for a volume that is not a vector in one grid or has another lattice, and
/// as checkWarpMemory() does.
[[nodiscard]] DisplacementFrames displacementsOf(
    std::span<const std::shared_ptr<const Volume>> frames, const Placement& placement,
    const std::string& path);

}  // namespace palpate
