/// What VTK has read, in the shapes that the importer knows: images, and meshes to be resampled.
#pragma once

#include <string>
#include <vector>

#include <vtkDataArray.h>
#include <vtkDataObject.h>

#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// The array's own memory.
[[nodiscard]] Values valuesOf(vtkDataArray* values);

/// Takes a vtkDataSet, or a composite of them, apart. Rectilinear and curvilinear grids whose
/// points stand as an image's are images; an image's cell data are an image of their own, with the
/// cells' centres for points; a mesh's cell data are moved to its points; blocks become one mesh.
/// What does so, and what cannot be taken along, is said in `notes`. Throws VolumeError where there
/// is no volume, but points, lines or surfaces.
[[nodiscard]] std::vector<Piece> piecesOf(vtkDataObject* data, const std::string& file,
                                          std::vector<std::string>& notes);

}  // namespace palpate::importer
