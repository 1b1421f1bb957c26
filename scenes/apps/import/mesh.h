#pragma once

#include <memory>
#include <string>
#include <vector>

#include <vtkDataSet.h>
#include <vtkSmartPointer.h>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Returns the cells that have a volume, are neither hidden nor duplicate, and have no hidden
/// point; null if there are none. Splits all cells into tetrahedra if isInsideCell() does not
/// support the type of some, such as polyhedra. Throws VolumeError if cells refer to points that do
/// not exist.
[[nodiscard]] vtkSmartPointer<vtkDataSet> solidCells(vtkDataSet* mesh, const std::string& file,
                                                     std::vector<std::string>& notes);

/// Returns true if a point with these parametric coordinates (0 to 1 in the cell) is inside the
/// cell, within the tolerance. VTK's function accepts the whole bounding box of a wedge.
/// @param tolerance  Distance outside the cell that still counts as inside, in parametric
///                   coordinates.
[[nodiscard]] bool isInsideCell(int type, const double parametric[3], double tolerance);

/// Returns a mesh that can be resampled. Its values at a place are VTK's interpolation in the cell
/// that contains the place.
[[nodiscard]] std::shared_ptr<const Mesh> meshOf(vtkDataSet* solid);

}  // namespace palpate::importer
