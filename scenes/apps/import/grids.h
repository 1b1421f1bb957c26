/// Converts images to OpenVDB grids. Voxels with the value of the surroundings are usually
/// inactive.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "palpate/samplers/bricks/brick_grid.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/shared.h"

namespace palpate::importer {

/// A grid, and numbers for the report in the unit of the values; for vectors, of their magnitudes.
struct Gridded {
  openvdb::GridBase::Ptr grid;  ///< FloatGrid or Vec3SGrid, named, with its transform.
  /// Makes the voxels in a box. Empty: all voxels are in `grid`.
  GridBox make;
  std::uint64_t voxels = 0;  ///< Number of voxels in the image, or inside the mesh.
  std::uint64_t active = 0;
  std::uint64_t holes = 0;  ///< Number of voxels without data: not finite, or hidden.
  double lowest = 0.0;      ///< Range of the active values.
  double highest = 0.0;
  double background = 0.0;
  double tolerance = 0.0;
  /// Suggested tolerance that hides noise around the object: 99 % of the values on the image's
  /// faces differ from the background by at most this value. `quieter_share` is the fraction of
  /// voxels that would stay active. Both are 0 for vectors, labels, meshes and images with missing
  /// voxels. They are also 0 if at most a tenth of the active voxels would become inactive, or if
  /// the suggestion is not between `tolerance` and 5 % of the range.
  double quieter_tolerance = 0.0;
  double quieter_share = 0.0;
};

[[nodiscard]] inline double lengthOf(float v) {
  return v;
}
[[nodiscard]] inline double lengthOf(const openvdb::Vec3f& v) {
  return openvdb::Vec3d(v).length();
}

/// Makes a grid of floats from an image. Voxels without data (not finite, or hidden) are inactive.
/// Voxels within the tolerance of the background get its value. They are inactive too, unless the
/// image has voxels without data: then only these are inactive (kMetaInactiveIsMissing). The
/// background is the median of the values on the image's faces; for vectors and labels it is 0.
/// Works in parallel. Does not copy the array. Throws VolumeError, which names `file`, if the
/// transform is singular, not finite, or too small for OpenVDB.
/// @param tolerance  Tolerance of the background, in the array's unit. If it is negative, no voxel
///                   counts as background.
[[nodiscard]] Gridded gridFromImage(const Piece& image, const Array& array, double tolerance,
                                    const std::string& file, const Progress& progress);

/// Makes a grid as gridFromImage does, but without its voxels. Gridded::make makes them in boxes,
/// and keeps the image in memory.
/// @param shared  Process group. A rank makes boxes in its bricks and their aprons. All other
///                results are of the whole image.
[[nodiscard]] Gridded gridOnRequest(const Piece& image, const Array& array, double tolerance,
                                    const std::string& file, const Progress& progress,
                                    const Shared& shared);

/// Makes a grid of cubes with edge `voxel` as gridFromImage does, by trilinear interpolation. The
/// centre of the first cube is at the lowest corner of the image's bounds. A cube has no data if
/// one of the voxels that it reads has none. Throws VolumeError as gridFromImage and countCubes do.
[[nodiscard]] Gridded gridOnCubes(const Piece& image, const Array& array, double voxel,
                                  double tolerance, const std::string& file,
                                  const Progress& progress);

/// Returns the transform of cubes. The centre of the first cube is at `origin`. Throws VolumeError
/// if the edge is below about 1.4e-5, because OpenVDB cannot represent it.
[[nodiscard]] openvdb::math::Transform::Ptr cubes(double edge, const openvdb::Vec3d& origin,
                                                  const std::string& file);

/// Returns the number of cubes along each axis that fill a box. Throws VolumeError if that is more
/// than kMostVoxels, 1e6 or more along an axis, or only 1 along each axis.
/// @param sides  Lengths of the box's sides, in the unit of `voxel` (the edge of a cube).
/// @param slack  Fraction of an edge by which the last voxel may be outside the box.
[[nodiscard]] std::array<int, 3> countCubes(const std::array<double, 3>& sides, double voxel,
                                            double slack, const std::string& file);

/// Largest number of cubes in a resampled volume. Some readers use it as a limit for values.
inline constexpr double kMostVoxels = 4e9;

}  // namespace palpate::importer
