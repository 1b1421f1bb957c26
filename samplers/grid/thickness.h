/// Finds weak places of an isosurface: thin solids, which a fast hand may pass, edges of the data,
/// and narrow gaps between two solids.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <optional>

#include "palpate/engine/scene/graph.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// A fast hand can pass through thinner solids [voxels]; docs/interfaces.md, check, has figures.
inline constexpr double kThick = 1.5;

/// Result of measureThickness. Voxels are counted along the path into the solid, in index space: a
/// long voxel counts as one along any of its edges.
struct Thickness {
  std::uint64_t surface_cells = 0;  ///< Cells with data, and corners on both sides of the level.
  std::uint64_t thin_cells = 0;     ///< Surface cells thinner than kThick where measured.
  std::uint64_t below_one = 0;      ///< Surface cells thinner than one voxel.
  double least = std::numeric_limits<double>::infinity();  ///< [voxels]; infinite: no thin cell.
  double tenth = std::numeric_limits<double>::infinity();  ///< A tenth of the thin cells are at
                                                           ///< most this thick, to 0.01 [voxels].
  Vec3 thinnest_F = Vec3::Zero();  ///< Place on the surface of the least thickness; file space.
  std::uint64_t crowd = 0;         ///< Most thin cells in a leaf's 8^3: a wall rather than specks.
  Vec3 crowd_F = Vec3::Zero();     ///< Place of the thinnest of these cells.
  std::uint64_t open_cells = 0;    ///< Cells of a level set at which the surface leaves its data.
  Vec3 open_F = Vec3::Zero();      ///< Lowest corner of the first open cell; file space.
};

/// Measures the thickness in every cell that the surface V = level passes through, at one place: a
/// root of the cell's own polynomial on the way from the centre to the steepest corner of the other
/// side. From there it goes kThick voxels into the solid, exactly, cell by cell. The direction
/// follows the cell's own gradient, not the smooth one that a mode uses, which averages both sides
/// of a thin wall away. If the value comes back to the free side, the solid is thin. The end of the
/// data is not a free side. A cell of a level set with corners on both sides is open if some
/// corners are inactive: the surface leaves its data there, and the force of a hand on it ends in
/// one tick.
///
/// It does not find holes. Where a wall is thinner than a voxel, the interpolant's ridge may fall
/// short of the level between voxels that reach it. Then no cell there has corners on both sides,
/// and no contact can stop a hand. Thin cells are found beside the hole.
///
/// Surfaces across faces of active tiles of more than 128 voxels are not checked.
/// @return  Empty unless `volume` is a scalar that is read trilinearly.
/// Parallel over leaves, without a copy of the grid: 12 bytes per leaf. A head's bone (CT, 4.8
/// million active voxels, 248,000 surface cells) takes 0.27 s on one core, 0.14 s on two.
[[nodiscard]] std::optional<Thickness> measureThickness(const std::shared_ptr<const Volume>& volume,
                                                        const Sampling& sampling, double level,
                                                        Solid solid);

/// Surfaces that face each other across less than this leave a gap [voxels]. Two solids that
/// overlap or touch leave no gap.
inline constexpr double kGap = 2.0;

/// The result of measureGap. Widths are counted in voxels as in Thickness.
struct Gap {
  std::uint64_t surface_cells = 0;  ///< Cells of the first surface that have data.
  std::uint64_t facing_cells = 0;   ///< Cells before which the other solid begins within kGap.
  double median = 0.0;              ///< Median width there, to 0.01 [voxels]; 0: no such cell.
  double widest = 0.0;              ///< Widest gap [voxels].
  double length_F = 0.0;            ///< Widest gap as a length [unit of the file].
  Vec3 widest_F = Vec3::Zero();     ///< Place of the widest gap on the first surface; file space.
};

/// Looks at every cell that the surface V = level passes through, at the place that
/// measureThickness takes. From there it goes kGap voxels outwards, exactly, cell by cell, and
/// measures where it meets the solid of `other`. Solids that touch within 0.05 voxel leave no gap.
///
/// @param place  Place of `volume` in the space of `other`.
/// @return  Empty unless `volume` is a scalar that is read trilinearly.
/// Parallel over leaves. Cost as measureThickness, and `other` is walked once from each cell.
[[nodiscard]] std::optional<Gap> measureGap(const std::shared_ptr<const Volume>& volume,
                                            const Sampling& sampling, double level, Solid solid,
                                            const Placement& place, const ScalarField& other,
                                            double other_level, Solid other_solid);

}  // namespace palpate
