/// Images become grids: voxels that equal their surroundings are left out.
#pragma once

#include <cstdint>
#include <string>

#include "palpate/samplers/openvdb_grids.h"
#include "palpate/scenes/import/reader.h"
#include "palpate/scenes/import/shared.h"

namespace palpate::importer {

/// A grid and what is worth telling about it; values in the array's unit, lengths for a vector.
struct Gridded {
  openvdb::GridBase::Ptr grid;  ///< FloatGrid or Vec3SGrid, named, with its transform.
  std::uint64_t voxels = 0;     ///< Of the image, or inside the mesh.
  std::uint64_t active = 0;     ///< Of these.
  std::uint64_t holes = 0;      ///< Of these, without data: not finite, or hidden.
  double lowest = 0.0;          ///< Of the active values.
  double highest = 0.0;
  double background = 0.0;
  double tolerance = 0.0;
  /// Noise about the object: a tolerance that would leave out what lies within the 99th percentile
  /// of what the faces differ by from the background, and the share of voxels that would be left;
  /// 0 where it would gain little or is more than 5 % of the range.
  double quieter_tolerance = 0.0;
  double quieter_share = 0.0;
};

/// What a range is of: a scalar itself, a vector's length.
[[nodiscard]] inline double lengthOf(float v) {
  return v;
}
[[nodiscard]] inline double lengthOf(const openvdb::Vec3f& v) {
  return openvdb::Vec3d(v).length();
}

/// The values of an image as floats. Inactive, hence no data or surroundings, are: values that are
/// not finite or hidden, and those within the tolerance of the background, which they become. The
/// background of a scalar is the median of the values on the faces of the image, what surrounds the
/// object; of a vector zero. Works leaf by leaf in parallel: takes the grid's memory and no more.
/// Throws VolumeError, with `file`, where the map is singular or the values are no numbers.
/// @param tolerance  In the array's unit, >= 0.
/// @param shared     Of several ranks each has the grid of its own bricks with their aprons; all
///                   else that is told is of the whole.
[[nodiscard]] Gridded gridFromImage(const Piece& image, const Array& array, double tolerance,
                                    const std::string& file, const Progress& progress,
                                    const Shared& shared);

/// The same on cubes, trilinear between the image's voxels: the first at the lowest corner of the
/// box about it. A place beside a hole is a hole.
/// @param voxel  Their edge, in the file's unit. Throws VolumeError if it makes too many, or none.
[[nodiscard]] Gridded gridOnCubes(const Piece& image, const Array& array, double voxel,
                                  double tolerance, const std::string& file,
                                  const Progress& progress);

/// Cubes of this edge from this place on. Throws VolumeError where OpenVDB cannot have them: edges
/// of 1e-5 and less.
[[nodiscard]] openvdb::math::Transform::Ptr cubes(double edge, const openvdb::Vec3d& origin,
                                                  const std::string& file);

/// More voxels than this in a box are refused: their leaves alone would take an hour.
inline constexpr double kMostVoxels = 4e9;

}  // namespace palpate::importer
