/// Prepares a solver's mesh for resampling.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include <vtkDataSet.h>
#include <vtkSmartPointer.h>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Returns the cells that hold data: cells with volume that are neither hidden nor at a hidden
/// point. Polyhedra, and cells that VTK cannot test for a place inside, are split into tetrahedra.
/// Null if no cell is left. Lists omitted cells in `notes`. Throws VolumeError if cells refer to
/// missing points.
[[nodiscard]] vtkSmartPointer<vtkDataSet> solidCells(vtkDataSet* mesh, const std::string& file,
                                                     std::vector<std::string>& notes);

/// Returns whether a place is inside a cell, by the cell's own coordinates there. VTK's own
/// answer is wrong for wedges: it accepts their whole bounding boxes.
/// @param type       Type of the cell, as solidCells returns it.
/// @param tolerance  Distance outside, in coordinates of 0 to 1, that still counts as inside.
[[nodiscard]] bool isInsideCell(int type, const double parametric[3], double tolerance);

/// Wraps the cells for resampling, with VTK's own interpolation in the cell that holds a place.
[[nodiscard]] std::shared_ptr<const Mesh> meshOf(vtkDataSet* solid);

}  // namespace palpate::importer
