/// Converts images to grids and leaves out voxels that equal their surroundings.
#pragma once

#include <cstdint>
#include <string>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/shared.h"

namespace palpate::importer {

/// A grid and its figures for a report. Values are in the array's unit; a vector counts as its
/// length.
struct Gridded {
  openvdb::GridBase::Ptr grid;  ///< FloatGrid or Vec3SGrid, named, with its transform.
  std::uint64_t voxels = 0;     ///< Voxels of the image, or inside the mesh.
  std::uint64_t active = 0;     ///< Active voxels among these.
  std::uint64_t holes = 0;      ///< Voxels among these without data: not finite, or hidden.
  double lowest = 0.0;          ///< Range of the active values.
  double highest = 0.0;
  double background = 0.0;
  double tolerance = 0.0;
  /// Noise around the object. This tolerance would leave out all values as near to the background
  /// as the nearest 99 % of the values on the faces; the share is that of the voxels that would
  /// remain. Both are 0 if the gain is small or the tolerance exceeds 5 % of the range.
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
/// @param tolerance  In the array's unit, >= 0.
/// @param shared     Each of several ranks gets the grid of its own bricks with their aprons. All
///                   other results describe the whole image.
[[nodiscard]] Gridded gridFromImage(const Piece& image, const Array& array, double tolerance,
                                    const std::string& file, const Progress& progress,
                                    const Shared& shared);

/// Does the same on cubes, trilinear between the image's voxels. The first cube is at the
/// lowest corner of the image's bounding box. A place beside a hole is a hole.
/// @param voxel  Edge of the cubes, in the file's unit. Throws VolumeError if it makes too many, or
///               none.
[[nodiscard]] Gridded gridOnCubes(const Piece& image, const Array& array, double voxel,
                                  double tolerance, const std::string& file,
                                  const Progress& progress);

/// Returns the transform of cubes with this edge, from this origin on. Throws VolumeError if
/// OpenVDB cannot represent them: edges of 1e-5 and less.
[[nodiscard]] openvdb::math::Transform::Ptr cubes(double edge, const openvdb::Vec3d& origin,
                                                  const std::string& file);

/// Boxes with more voxels are rejected: their leaves alone would take an hour.
inline constexpr double kMostVoxels = 4e9;

}  // namespace palpate::importer
