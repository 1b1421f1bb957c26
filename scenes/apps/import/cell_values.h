/// Private to the importer: extrapolates one value per cell to the boundary of a mesh.
#pragma once

#include <string>
#include <vector>

#include <vtkDataSet.h>

namespace palpate::importer {

/// Corrects the averages of cell values at the points on the boundary of a mesh.
///
/// An average over the cells around a point is the value at the mean of their centres. At a
/// boundary, all cells are on one side, so this mean is half a cell away, and derivatives there are
/// about half of those inside. This function adds the difference between point and mean, from a
/// polynomial of degree 2 that fits the cells within three cells of the point (of degree 1 if these
/// do not determine degree 2). The difference is limited to the range of these cells. Scalars stay
/// in the range of all cells, so that a fraction or a temperature gets no new extreme.
///
/// Changes only arrays of floats and doubles. Points near a value that is not finite keep their
/// averages. Works in parallel.
/// @param mesh   Mesh with the cells' values, and with their averages at the points.
/// @param names  Arrays of the points to change.
void extrapolateToBoundary(vtkDataSet* mesh, const std::vector<std::string>& names);

}  // namespace palpate::importer
