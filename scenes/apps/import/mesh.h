/// Prepares the mesh of a simulation program for resampling.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include <vtkDataSet.h>
#include <vtkSmartPointer.h>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Returns the cells with data: cells with a volume that are not hidden and have no hidden point.
/// Splits polyhedra, and other cells in which VTK cannot locate a place, into tetrahedra. Returns
/// null if no cell is left. Adds notes about omitted cells. Throws VolumeError if cells refer to
/// points that do not exist.
[[nodiscard]] vtkSmartPointer<vtkDataSet> solidCells(vtkDataSet* mesh, const std::string& file,
                                                     std::vector<std::string>& notes);

/// Returns true if a place with these parametric coordinates is inside a cell. VTK's own function
/// is wrong for wedges: it accepts the whole bounding box.
/// @param type       Type of the cell, from solidCells.
/// @param tolerance  Distance outside the cell that still counts as inside, in coordinates of 0 to
///                   1.
[[nodiscard]] bool isInsideCell(int type, const double parametric[3], double tolerance);

/// Returns a mesh that can be resampled. Values are interpolated by VTK in the cell that contains
/// the place.
[[nodiscard]] std::shared_ptr<const Mesh> meshOf(vtkDataSet* solid);

}  // namespace palpate::importer
