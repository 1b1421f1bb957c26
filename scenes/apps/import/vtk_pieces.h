/// Converts data of VTK to the importer's pieces: images, and meshes that are resampled later.
#pragma once

#include <string>
#include <vector>

#include <vtkDataArray.h>
#include <vtkDataObject.h>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Returns values in the memory of a VTK array.
[[nodiscard]] Values valuesOf(vtkDataArray* values);

/// Splits a vtkDataSet or a composite data set into pieces.
///
/// Rectilinear and curvilinear grids become images if their points form an even lattice. The cell
/// values of an image become a second image, at the centres of the cells. The cell values of a mesh
/// are averaged to its points. All meshes are joined. Adds notes about conversions and omitted
/// arrays. Throws VolumeError for data without a volume, and for arrays of a wrong length.
[[nodiscard]] std::vector<Piece> piecesOf(vtkDataObject* data, const std::string& file,
                                          std::vector<std::string>& notes);

}  // namespace palpate::importer
