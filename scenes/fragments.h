/// Private to the program: large scenes of real data, the solid of a volume broken into fragments
/// that are strewn about.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>

#include "palpate/engine/graph.h"
#include "palpate/samplers/volume.h"

namespace palpate {

/// How a solid is broken and strewn. The same order gives the same voxels and the same scene.
struct FragmentOrder {
  double value = 0.0;             ///< The solid's surface is where the volume has it,
  Solid solid = Solid::kAbove;    ///< and this side of it is the solid.
  int pieces = 64;                ///< Files, 2 to kMostPieces.
  int places = 10000;             ///< Places, at least as many as pieces, at most kMostFragments.
  double metres_per_unit = 1e-3;  ///< Of the file's own space: true size by default, for mm.
  double room = 1.0;              ///< Edge of the cube that the fragments' middles lie in [m].
  double strength = 3.0;          ///< Of every surface [N].
  std::uint64_t seed = 1;         ///< Where they break and lie.
};

inline constexpr int kMostPieces = 1000;        ///< Of FragmentOrder::pieces: each is a file.
inline constexpr int kMostFragments = 1000000;  ///< Of FragmentOrder::places.

/// What came of it.
struct Fragments {
  int pieces = 0;  ///< Fewer than ordered where a site was drawn twice or a piece has only
                   ///< a few voxels.
  int places = 0;  ///< Instances in the scene, as ordered, dealt out to the pieces in turn.
  std::uint64_t voxels = 0;  ///< Active in all files.
  double size = 0.0;         ///< Mean of the pieces' longest sides [m].
  double overlap = 0.0;      ///< Fragments' boxes that hold a point of the room, in the mean.
};

/// Writes fragment-*.vdb and scene.json into a folder that is there.
///
/// Sites are drawn from the solid's voxels; a piece is what is nearest to one of them. Its value is
/// the volume's as far as the nearest face that it is broken along, and falls off from there as it
/// does at the solid's own surface in the mean, by length: so each piece is closed, and its faces
/// feel like the rest. What is farther below the surface's value than three voxels' fall is left
/// out. A piece's origin is its middle.
///
/// @param progress  From 0 to 1; whoever throws there cancels.
/// Throws Error for an order out of range, for a volume of vectors or a level set (whose inside has
/// no data), where there is no solid, and where a file cannot be written.
[[nodiscard]] Fragments strewFragments(const Volume& volume, const FragmentOrder& order,
                                       const std::filesystem::path& folder,
                                       const std::function<void(double)>& progress = nullptr);

}  // namespace palpate
