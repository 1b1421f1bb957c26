#include "palpate/scenes/apps/import/mesh.h"

#include <algorithm>

#include <fmt/format.h>
#include <vtkCellArray.h>
#include <vtkCellData.h>
#include <vtkCellType.h>
#include <vtkCellTypes.h>
#include <vtkDataSetAttributes.h>
#include <vtkDataSetTriangleFilter.h>
#include <vtkExtractCells.h>
#include <vtkGenericCell.h>
#include <vtkIdList.h>
#include <vtkNew.h>
#include <vtkPointData.h>
#include <vtkUnsignedCharArray.h>
#include <vtkUnstructuredGrid.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/vtk_run.h"

namespace palpate::importer {
namespace {

bool isTetrahedron(int type) {
  return type == VTK_TETRA || type == VTK_QUADRATIC_TETRA;
}
bool isWedge(int type) {
  return type == VTK_WEDGE || type == VTK_QUADRATIC_WEDGE || type == VTK_QUADRATIC_LINEAR_WEDGE ||
         type == VTK_BIQUADRATIC_QUADRATIC_WEDGE;
}
/// Returns true if isInsideCell() supports cells of this type.
bool hasCoordinates(int type) {
  switch (type) {
    case VTK_VOXEL:
    case VTK_HEXAHEDRON:
    case VTK_PYRAMID:
    case VTK_QUADRATIC_HEXAHEDRON:
    case VTK_QUADRATIC_PYRAMID:
    case VTK_TRIQUADRATIC_HEXAHEDRON:
    case VTK_BIQUADRATIC_QUADRATIC_HEXAHEDRON:
      return true;
    default:
      return isTetrahedron(type) || isWedge(type);
  }
}

vtkUnsignedCharArray* ghostsOf(vtkDataSetAttributes* attributes) {
  return vtkUnsignedCharArray::SafeDownCast(
      attributes->GetArray(vtkDataSetAttributes::GhostArrayName()));
}

void checkPoints(vtkDataSet* mesh, const std::string& file) {
  auto* grid = vtkUnstructuredGrid::SafeDownCast(mesh);
  if (grid == nullptr || grid->GetNumberOfCells() == 0) return;
  double range[2] = {0.0, 0.0};
  grid->GetCells()->GetConnectivityArray()->GetRange(range, 0);
  if (range[0] < 0.0 || range[1] >= static_cast<double>(grid->GetNumberOfPoints())) {
    throw VolumeError(
        file,
        fmt::format("the cells refer to points {:.0f} to {:.0f}, counted from 0, but the mesh has "
                    "{} points",
                    range[0], range[1], grid->GetNumberOfPoints()),
        "the file is damaged: export it again");
  }
}

}  // namespace

vtkSmartPointer<vtkDataSet> solidCells(vtkDataSet* mesh, const std::string& file,
                                       std::vector<std::string>& notes) {
  checkPoints(mesh, file);
  vtkUnsignedCharArray* hidden_cells = ghostsOf(mesh->GetCellData());
  vtkUnsignedCharArray* hidden_points = ghostsOf(mesh->GetPointData());
  constexpr int kNoCell = vtkDataSetAttributes::HIDDENCELL | vtkDataSetAttributes::DUPLICATECELL;
  vtkNew<vtkIdList> solid;
  vtkNew<vtkGenericCell> cell;
  vtkNew<vtkIdList> points;
  vtkIdType flat = 0;
  vtkIdType hidden = 0;
  bool to_split = false;
  for (vtkIdType c = 0; c < mesh->GetNumberOfCells(); ++c) {
    cell->SetCellType(mesh->GetCellType(c));
    if (cell->GetCellDimension() != 3) {
      ++flat;
      continue;
    }
    bool here = hidden_cells == nullptr || (hidden_cells->GetValue(c) & kNoCell) == 0;
    if (here && hidden_points != nullptr) {
      mesh->GetCellPoints(c, points);
      for (vtkIdType p = 0; p < points->GetNumberOfIds(); ++p) {
        here = here &&
               (hidden_points->GetValue(points->GetId(p)) & vtkDataSetAttributes::HIDDENPOINT) == 0;
      }
    }
    if (!here) {
      ++hidden;
      continue;
    }
    to_split = to_split || !hasCoordinates(mesh->GetCellType(c));
    solid->InsertNextId(c);
  }
  if (solid->GetNumberOfIds() == 0) return nullptr;
  if (flat > 0) notes.push_back(fmt::format("{} cells without volume were skipped", flat));
  if (hidden > 0) {
    notes.push_back(fmt::format(
        "{} cells were skipped: the file marks them or one of their points as hidden, or "
        "the cells as duplicate",
        hidden));
  }

  vtkSmartPointer<vtkDataSet> out = mesh;
  if (flat + hidden > 0) {
    vtkNew<vtkExtractCells> extract;
    extract->SetInputData(mesh);
    extract->SetCellList(solid);
    extract->AssumeSortedAndUniqueIdsOn();
    run(extract, file);
    out = extract->GetOutput();
    out->GetPointData()->RemoveArray(vtkDataSetAttributes::GhostArrayName());
    out->GetCellData()->RemoveArray(vtkDataSetAttributes::GhostArrayName());
  }
  if (to_split) {
    vtkNew<vtkDataSetTriangleFilter> split;
    split->SetInputData(out);
    split->TetrahedraOnlyOn();
    run(split, file);
    out = split->GetOutput();
    notes.emplace_back(
        "all cells were split into tetrahedra, because some are polyhedra or of high order");
  }
  return out;
}

bool isInsideCell(int type, const double parametric[3], double tolerance) {
  const auto [low, high] = std::minmax({parametric[0], parametric[1], parametric[2]});
  if (!(low >= -tolerance && high <= 1.0 + tolerance)) return false;
  if (isTetrahedron(type)) {
    return parametric[0] + parametric[1] + parametric[2] <= 1.0 + tolerance;
  }
  return !isWedge(type) || parametric[0] + parametric[1] <= 1.0 + tolerance;
}

}  // namespace palpate::importer
