/// Converts images to OpenVDB grids. Voxels that equal the image's surroundings become inactive.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/shared.h"

namespace palpate::importer {

/// A grid, and the numbers of a report about it. Values are in the array's unit; for a vector they
/// are magnitudes.
struct Gridded {
  openvdb::GridBase::Ptr grid;  ///< FloatGrid or Vec3SGrid, named, with its transform.
  std::uint64_t voxels = 0;     ///< Number of voxels of the image, or in the mesh.
  std::uint64_t active = 0;     ///< Number of active voxels among these.
  std::uint64_t holes = 0;  ///< Number of voxels among these without data: not finite, or hidden.
  double lowest = 0.0;      ///< Lowest active value; `highest` is the highest one.
  double highest = 0.0;
  double background = 0.0;
  double tolerance = 0.0;
  /// Suggested tolerance that makes noise around the object inactive. 99 % of the values on the
  /// image's faces differ from the background by at most this. The share is the fraction of voxels
  /// that would stay active. Both are 0 if few voxels would become inactive, or if the tolerance
  /// exceeds 5 % of the range.
  double quieter_tolerance = 0.0;
  double quieter_share = 0.0;
};

/// Returns the magnitude of a value: a scalar itself, or the length of a vector.
[[nodiscard]] inline double lengthOf(float v) {
  return v;
}
[[nodiscard]] inline double lengthOf(const openvdb::Vec3f& v) {
  return openvdb::Vec3d(v).length();
}

/// Makes a grid of floats from an image.
///
/// Voxels without data are inactive: their value is not finite, or they are hidden. Voxels within
/// the tolerance of the background are also inactive, and get the value of the background. The
/// background of a scalar is the median of the values on the image's faces; that of a vector is
/// zero. Works in parallel, leaf by leaf, and needs no memory except that of the grid. Throws
/// VolumeError, which names `file`, if the transform is singular or the values are not numbers.
/// @param tolerance  Tolerance about the background, in the array's unit, >= 0.
/// @param shared     Process group. Each rank gets the part of the grid in its own bricks and their
///                   aprons. All other results describe the whole image.
[[nodiscard]] Gridded gridFromImage(const Piece& image, const Array& array, double tolerance,
                                    const std::string& file, const Progress& progress,
                                    const Shared& shared);

/// Makes a grid with cubic voxels as gridFromImage does. Values are interpolated trilinearly
/// between the voxels of the image. The first cube is at the lowest corner of the image's bounding
/// box. A cube has no data if a voxel that it is interpolated from has no data. Throws VolumeError
/// as countCubes does.
/// @param voxel  Edge of the cubes, in the file's unit.
[[nodiscard]] Gridded gridOnCubes(const Piece& image, const Array& array, double voxel,
                                  double tolerance, const std::string& file,
                                  const Progress& progress);

/// Returns the transform of cubic voxels with this edge and this origin. Throws VolumeError if the
/// edge is 1e-5 or less, because OpenVDB cannot represent such voxels.
[[nodiscard]] openvdb::math::Transform::Ptr cubes(double edge, const openvdb::Vec3d& origin,
                                                  const std::string& file);

/// Returns the number of cubes along each axis that fill a box. Throws VolumeError, which names
/// `file`, if there are more than kMostVoxels, if there are more than 1e6 along an axis, or if
/// there is only one along each axis.
/// @param sides  Lengths of the box's sides, in the unit of `voxel` (the edge of a cube).
/// @param slack  Fraction of an edge by which the last voxel may lie outside the box.
[[nodiscard]] std::array<int, 3> countCubes(const std::array<double, 3>& sides, double voxel,
                                            double slack, const std::string& file);

/// Largest number of voxels in a box. For more voxels, making the leaves alone would take an hour.
inline constexpr double kMostVoxels = 4e9;

}  // namespace palpate::importer
