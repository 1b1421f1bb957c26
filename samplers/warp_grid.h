/// How a volume deforms by displacement fields on a lattice: from files, or from memory.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "palpate/engine/warp.h"
#include "palpate/samplers/vdb_field.h"
#include "palpate/samplers/volume.h"

namespace palpate {

/// The times of displacement fields.
struct WarpTimes {
  std::vector<double> times;  ///< Of the frames, ascending [s]; of a single frame any or none.
  bool repeat = false;        ///< Over and over: the last frame is the first again.
};

/// Displacement fields on one lattice of places in the volume's resting frame.
struct DisplacementFrames {
  std::array<int, 3> size{};     ///< Nodes along each axis, at least 2.
  Vec3 origin = Vec3::Zero();    ///< Where node (0, 0, 0) is [m].
  Mat3 axes = Mat3::Identity();  ///< From a node to the next along each axis, a column each [m].
  std::vector<std::vector<float>> frames;  ///< u [m], x y z a node, the last axis fastest.
};

/// Most memory of a warp [bytes].
inline constexpr std::uint64_t kMostWarpMemory = 1ULL << 30;
/// Throws SceneError at `path` where so many frames of such a lattice were more.
void checkWarpMemory(const std::array<int, 3>& size, std::size_t frames, const std::string& path);

/// A warp that takes u from frames: X = x + u(x, t).
///
/// In space u is the quadratic B-spline through the nodes, which is continuous in its slope, with
/// no curvature across the lattice's faces; beyond these u is that of the nearest place on them. In
/// time it is the cubic through the frames by Hermite, with the slopes of the parabolas through
/// three frames: continuous in its rate. Before the first frame and after the last it holds and its
/// rate is zero, or it repeats.
///
/// Throws SceneError, with `path` before what is wrong (/times/2): no frame, another number of
/// times, times that do not ascend, a repeated warp that does not end as it began, u that is not
/// finite, more memory than kMostWarpMemory, and one that folds space or makes lengths of matter
/// more than ten times as long or as short, where it is looked at: at all nodes and middles of
/// cells, at all frames and quarters between. Slow, parallel; 32 bytes a node and frame, of the
/// lattice with one node more all round, and about twice that meanwhile. RT: at() reads 27 nodes.
[[nodiscard]] WarpPtr makeWarp(const DisplacementFrames& of, const WarpTimes& when,
                               const std::string& path);

/// The displacements that vector volumes are, one a frame, all on one lattice: of the box of their
/// active voxels, and a voxel of background about it where not all of them are active, in the
/// files' own unit of length, as their axes are; the placement scales and turns them. Throws
/// SceneError at `path`: no vector in one grid, or another lattice.
[[nodiscard]] DisplacementFrames displacementsOf(
    std::span<const std::shared_ptr<const Volume>> frames, const Placement& placement,
    const std::string& path);

}  // namespace palpate
