/// A solver's mesh, made fit to be resampled.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include <vtkDataSet.h>
#include <vtkSmartPointer.h>

#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// The cells that hold data: with volume, neither hidden nor at a hidden point; polyhedra and cells
/// whose inside VTK cannot tell are split into tetrahedra. Null if none is left. What is left out
/// is said in `notes`. Throws VolumeError where cells name points that are not there.
[[nodiscard]] vtkSmartPointer<vtkDataSet> solidCells(vtkDataSet* mesh, const std::string& file,
                                                     std::vector<std::string>& notes);

/// Is a place inside of a cell, by the cell's own coordinates there? VTK's answer is not good
/// enough: its wedges are as wide as the boxes about them.
/// @param type       Of the cell, one that solidCells leaves.
/// @param tolerance  So far outside, in coordinates of 0 to 1, still counts as inside.
[[nodiscard]] bool isInsideCell(int type, const double parametric[3], double tolerance);

/// To be resampled: of the cell that holds a place, VTK's own interpolation.
[[nodiscard]] std::shared_ptr<const Mesh> meshOf(vtkDataSet* solid);

}  // namespace palpate::importer
