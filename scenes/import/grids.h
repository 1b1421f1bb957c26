/// Images become grids: voxels that equal their surroundings are left out.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include <openvdb/openvdb.h>

#include "scenes/import/pieces.h"

namespace palpate::importer {

/// A grid and what is worth telling about it.
struct Gridded {
  openvdb::GridBase::Ptr grid;  ///< FloatGrid or Vec3SGrid, named, with its transform.
  std::uint64_t voxels = 0;     ///< Of the image, or inside the mesh.
  std::uint64_t holes = 0;      ///< Of these, without data: not finite, or hidden.
  double lowest = 0.0;          ///< Of the active values, magnitudes for a vector.
  double highest = 0.0;
  double background = 0.0;
  double tolerance = 0.0;
  /// Noise about the object: a tolerance that would leave out what lies within the 99th percentile
  /// of what the faces differ by from the background, and the share of voxels that would be left;
  /// 0 where it would gain little or is more than 5 % of the range.
  double quieter_tolerance = 0.0;
  double quieter_share = 0.0;
};

/// The values of an image as floats. Inactive, hence no data or surroundings, are: values that are
/// not finite or hidden, and those within the tolerance of the background, which they become. The
/// background of a scalar is the median of the values on the faces of the image, what surrounds the
/// object; of a vector zero. Works leaf by leaf in parallel: takes the grid's memory and no more.
[[nodiscard]] Gridded gridFromImage(const Piece& image, const Array& array, double tolerance,
                                    const Progress& progress);

/// The transform of an image. Throws VolumeError where it is singular.
[[nodiscard]] openvdb::math::Transform::Ptr transformOf(const Affine& file_from_index,
                                                        const std::string& file);

}  // namespace palpate::importer
