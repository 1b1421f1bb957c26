/// Deforms a volume by displacement fields on a lattice, from files or from memory.
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
  std::vector<double> times;  ///< Times of the frames, ascending [s]; for a single frame optional.
  bool repeat = false;        ///< Plays in a loop: the last frame is the first again.
};

/// Displacement fields on one lattice of points in the volume's resting frame.
struct DisplacementFrames {
  std::array<int, 3> size{};               ///< Nodes along each axis, at least 2.
  Vec3 origin = Vec3::Zero();              ///< Place of node (0, 0, 0) [m].
  Mat3 axes = Mat3::Identity();            ///< Columns: step to the next node along each axis [m].
  std::vector<std::vector<float>> frames;  ///< u [m], x y z per node, the last axis fastest.
};

/// Memory limit of a warp [bytes].
inline constexpr std::uint64_t kMostWarpMemory = 1ULL << 30;
/// Throws SceneError at `path` if `frames` frames of a lattice of this size need more memory than
/// kMostWarpMemory.
void checkWarpMemory(const std::array<int, 3>& size, std::size_t frames, const std::string& path);

/// Makes a warp that takes u from frames: X = x + u(x, t).
///
/// In space u is the quadratic B-spline through the nodes. Its slope is continuous, and it has no
/// curvature across the lattice's faces. Beyond the faces u is that of the nearest place on them.
/// In time u is the cubic Hermite curve through the frames, with the slopes of the parabolas
/// through three frames; its rate is continuous. Before the first frame and after the last, u holds
/// and its rate is zero, unless the warp repeats.
///
/// Throws SceneError, with `path` and the faulty part (/times/2), for: no frame, another number of
/// times, times that do not ascend, a repeated warp that does not end as it began, u that is not
/// finite, and more memory than kMostWarpMemory. Also throws for a warp that folds space, or makes
/// lengths of matter more than ten times as long or as short. It checks that at all nodes and
/// middles of cells, at all frames and quarters between. Slow, parallel. Takes 32 bytes per node
/// and frame, of the lattice with one more node all round, and about twice that during the call.
/// RT: at() reads 27 nodes.
[[nodiscard]] WarpPtr makeWarp(const DisplacementFrames& of, const WarpTimes& when,
                               const std::string& path);

/// Returns the displacements of vector volumes, one per frame, all on one lattice: the box of their
/// active voxels, with a voxel of background around it if not all of the box is active. Vectors and
/// axes are in the files' own unit of length; the placement scales and turns them. Throws
/// SceneError at `path` for a volume that is not a vector in one grid, or is on another lattice.
[[nodiscard]] DisplacementFrames displacementsOf(
    std::span<const std::shared_ptr<const Volume>> frames, const Placement& placement,
    const std::string& path);

}  // namespace palpate
