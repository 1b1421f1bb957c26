/// Converts VTK's data to the importer's pieces: images, and meshes to be resampled.
#pragma once

#include <string>
#include <vector>

#include <vtkDataArray.h>
#include <vtkDataObject.h>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Returns values that share the array's memory.
[[nodiscard]] Values valuesOf(vtkDataArray* values);

/// Splits a vtkDataSet, or a composite data set, into pieces. Rectilinear and curvilinear grids are
/// images if their points lie on an image's lattice. An image's cell data become a second image,
/// with the cells' centres as points. A mesh's cell data are moved to its points. Blocks become one
/// mesh. Conversions and omitted arrays are listed in `notes`. Throws VolumeError if there is no
/// volume, only points, lines or surfaces.
[[nodiscard]] std::vector<Piece> piecesOf(vtkDataObject* data, const std::string& file,
                                          std::vector<std::string>& notes);

}  // namespace palpate::importer
