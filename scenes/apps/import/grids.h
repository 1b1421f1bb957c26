/// Converts images to grids, in which voxels that equal their surroundings are inactive.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/shared.h"

namespace palpate::importer {

/// A grid and its figures for a report. Values are in the array's unit; those of a vector are
/// lengths.
struct Gridded {
  openvdb::GridBase::Ptr grid;  ///< FloatGrid or Vec3SGrid, named, with its transform.
  std::uint64_t voxels = 0;     ///< Voxels of the image, or inside the mesh.
  std::uint64_t active = 0;     ///< Active voxels among these.
  std::uint64_t holes = 0;      ///< Voxels among these without data: not finite, or hidden.
  double lowest = 0.0;          ///< Range of the active values.
  double highest = 0.0;
  double background = 0.0;
  double tolerance = 0.0;
  /// A tolerance that removes the noise around the object: 99 % of the values on the image's faces
  /// are within it of the background. The share is the part of the voxels that would stay active.
  /// Both are 0 if the gain is small or the tolerance exceeds 5 % of the range.
  double quieter_tolerance = 0.0;
  double quieter_share = 0.0;
};

/// Returns the quantity that a range describes: a scalar itself, a vector's length.
[[nodiscard]] inline double lengthOf(float v) {
  return v;
}
[[nodiscard]] inline double lengthOf(const openvdb::Vec3f& v) {
  return openvdb::Vec3d(v).length();
}

/// Makes a grid of floats from an image. Two kinds of voxels are inactive: values that are not
/// finite or hidden (no data), and values within the tolerance of the background (surroundings).
/// The latter become the background. The background of a scalar is the median of the values on the
/// image's faces, as the object's surroundings; the background of a vector is zero. Works leaf by
/// leaf in parallel, and takes no memory beyond the grid's. Throws VolumeError, with `file`, if the
/// map is singular or the values are not numbers.
/// @param tolerance  Tolerance about the background, in the array's unit, >= 0.
/// @param shared     Each of several ranks gets the grid of its own bricks with their aprons. All
///                   other results describe the whole image.
[[nodiscard]] Gridded gridFromImage(const Piece& image, const Array& array, double tolerance,
                                    const std::string& file, const Progress& progress,
                                    const Shared& shared);

/// Makes a grid of cubes as gridFromImage does, with values interpolated trilinearly between the
/// image's voxels. The first cube is at the lowest corner of the image's bounding box. A place
/// beside a hole is a hole. Throws VolumeError as countCubes does.
/// @param voxel  Edge of the cubes, in the file's unit.
[[nodiscard]] Gridded gridOnCubes(const Piece& image, const Array& array, double voxel,
                                  double tolerance, const std::string& file,
                                  const Progress& progress);

/// Returns the transform of cubes with this edge, from this origin on. Throws VolumeError if the
/// edge is 1e-5 or less, which OpenVDB cannot represent.
[[nodiscard]] openvdb::math::Transform::Ptr cubes(double edge, const openvdb::Vec3d& origin,
                                                  const std::string& file);

/// Returns the number of cubes along each axis that fill a box with these sides. Throws
/// VolumeError, with `file`, if there are more than kMostVoxels or 1e6 along an axis, or only one
/// along each axis.
/// @param sides  Lengths of the sides, in the unit of `voxel` (the edge of a cube).
/// @param slack  Part of an edge by which the last voxel may be outside the box.
[[nodiscard]] std::array<int, 3> countCubes(const std::array<double, 3>& sides, double voxel,
                                            double slack, const std::string& file);

/// Boxes with more voxels are rejected: their leaves alone would take an hour.
inline constexpr double kMostVoxels = 4e9;

}  // namespace palpate::importer
