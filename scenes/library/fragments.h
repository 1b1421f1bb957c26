/// Private to the program: large scenes of real data. A volume's solid is broken into fragments
/// that are scattered.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include "palpate/engine/scene/graph.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Parameters of the fragments. The same order gives the same voxels and the same scene.
struct FragmentOrder {
  double value = 0.0;             ///< Value at the solid's surface.
  Solid solid = Solid::kAbove;    ///< The side of it that is solid.
  int pieces = 64;                ///< Number of files, 2 to kMostPieces.
  int places = 10000;             ///< Number of instances, >= pieces, at most kMostFragments.
  double metres_per_unit = 1e-3;  ///< Scale of the file's space: by default true size, for mm.
  double room = 1.0;              ///< Edge of the cube that holds the fragments' middles [m].
  double strength = 3.0;          ///< Strength of every surface [N].
  std::uint64_t seed = 1;         ///< Seed of the breaks and places.
};

inline constexpr int kMostPieces = 1000;        ///< Limit of FragmentOrder::pieces: each is a file.
inline constexpr int kMostFragments = 1000000;  ///< Limit of FragmentOrder::places.

/// Result of strewFragments.
struct Fragments {
  int pieces = 0;  ///< Fewer than ordered if a site was drawn twice or a piece has only a few
                   ///< voxels.
  int places = 0;  ///< Instances in the scene, as ordered; the pieces take turns.
  std::uint64_t voxels = 0;  ///< Active voxels in all files.
  double size = 0.0;         ///< Mean of the pieces' longest sides [m].
  double overlap = 0.0;      ///< Mean number of fragment boxes that hold a point of the room.
};

/// Writes fragment-*.vdb and scene.json into an existing folder.
///
/// The sites are drawn from the solid's voxels; a piece consists of the voxels nearest to one site.
/// Its value is the volume's value, limited by a ramp that falls through the surface's value at the
/// nearest broken face. The ramp's slope is the mean slope, by length, at the solid's own surface.
/// So each piece is closed, and its faces feel like the rest. Voxels that are farther below the
/// surface's value than three voxels' fall are left out. A piece's origin is its middle.
///
/// @param progress  From 0 to 1; an exception thrown by it cancels.
/// Throws Error if the order is out of range, the volume has vectors or is a level set (without
/// data inside), there is no solid, or a file cannot be written.
[[nodiscard]] Fragments strewFragments(const Volume& volume, const FragmentOrder& order,
                                       const std::filesystem::path& folder,
                                       const std::function<void(double)>& progress = nullptr);

}  // namespace palpate
