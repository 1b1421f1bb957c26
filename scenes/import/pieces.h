/// What was read, in the two shapes that the importer knows: images, and meshes to be resampled.
#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include <vtkDataArray.h>
#include <vtkDataSet.h>
#include <vtkSmartPointer.h>
#include <vtkUnsignedCharArray.h>

#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// One value, vector or tensor a point.
struct Array {
  std::string name;
  vtkSmartPointer<vtkDataArray> values;
  std::string unit;    ///< Of the values; empty: not known.
  std::string given;   ///< Its name in the file, where others share it.
  bool axial = false;  ///< Vectors whose sign means nothing, as a fibre's direction.
};

/// Points with arrays on them.
struct Piece {
  vtkSmartPointer<vtkDataSet> mesh;              ///< Null for an image.
  std::array<int, 3> size{};                     ///< An image's points along i, j and k; i fastest.
  Affine file_from_index;                        ///< An image's.
  vtkSmartPointer<vtkUnsignedCharArray> hidden;  ///< An image's points: not 0 is no data; or null.
  std::vector<Array> arrays;

  [[nodiscard]] bool isImage() const { return mesh == nullptr; }
};

/// Takes the content apart. Rectilinear and curvilinear grids whose points stand as an image's are
/// images; an image's cell data are an image of their own, with the cells' centres for points; a
/// mesh's cell data are moved to its points; blocks become one mesh. What does so, and what cannot
/// be taken along, is said in `notes`. Throws VolumeError where there is nothing to feel: no array,
/// a flat image, surfaces without volume.
[[nodiscard]] std::vector<Piece> takeApart(const Content& content, const std::string& file,
                                           std::vector<std::string>& notes);

/// Keeps the arrays that were asked for, all if none was. Throws VolumeError that lists what there
/// is.
void select(std::vector<Piece>& pieces, const std::vector<std::string>& fields,
            const std::string& file);

}  // namespace palpate::importer
