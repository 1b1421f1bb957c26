#pragma once

#include <memory>
#include <string>
#include <vector>

#include <vtkDataSet.h>
#include <vtkSmartPointer.h>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Returns the cells that have a volume, are not hidden and have no hidden point; null: no cell is
/// left. Splits cells in which VTK cannot locate a place, such as polyhedra, into tetrahedra.
/// Throws VolumeError if cells refer to points that do not exist.
[[nodiscard]] vtkSmartPointer<vtkDataSet> solidCells(vtkDataSet* mesh, const std::string& file,
                                                     std::vector<std::string>& notes);

/// Returns true if a place with these parametric coordinates (0 to 1) is inside a cell, within the
/// tolerance. VTK's own function accepts the whole bounding box of a wedge.
/// @param tolerance  Distance outside the cell that still counts as inside, in coordinates of 0 to
///                   1.
[[nodiscard]] bool isInsideCell(int type, const double parametric[3], double tolerance);

/// Returns a mesh that can be resampled. VTK interpolates in the cell that contains the place.
[[nodiscard]] std::shared_ptr<const Mesh> meshOf(vtkDataSet* solid);

}  // namespace palpate::importer
