#include "palpate/scenes/apps/import/vtk_pieces.h"

#include <algorithm>
#include <cstring>
#include <map>
#include <optional>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <vtkAppendFilter.h>
#include <vtkBitArray.h>
#include <vtkCellData.h>
#include <vtkCellDataToPointData.h>
#include <vtkCompositeDataIterator.h>
#include <vtkCompositeDataSet.h>
#include <vtkDataSet.h>
#include <vtkDataSetAttributes.h>
#include <vtkDoubleArray.h>
#include <vtkImageData.h>
#include <vtkMatrix4x4.h>
#include <vtkNew.h>
#include <vtkPointData.h>
#include <vtkRectilinearGrid.h>
#include <vtkSmartPointer.h>
#include <vtkStructuredGrid.h>
#include <vtkUnsignedCharArray.h>
#include <vtkUnstructuredGrid.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/cell_values.h"
#include "palpate/scenes/apps/import/fill_values.h"
#include "palpate/scenes/apps/import/mesh.h"
#include "palpate/scenes/apps/import/shared.h"
#include "palpate/scenes/apps/import/vtk_run.h"
#include "palpate/scenes/apps/import/whole_numbers.h"

namespace palpate::importer {
namespace {

/// Largest distance of a point from an image's lattice, relative to a voxel's edge.
constexpr double kStraight = 1e-5;

Vec3 pointOf(vtkDataSet* data, vtkIdType index) {
  Vec3 p;
  data->GetPoint(index, p.data());
  return p;
}

Affine mapOf(vtkImageData* image) {
  Affine map;
  const vtkMatrix4x4* matrix = image->GetIndexToPhysicalMatrix();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      map.linear(row, column) = matrix->GetElement(row, column);
    }
    map.origin[row] = matrix->GetElement(row, 3);
  }
  // The first point may have an index other than 0.
  const int* extent = image->GetExtent();
  map.origin += map.linear * Vec3(extent[0], extent[2], extent[4]);
  return map;
}

/// Returns the transform of a grid whose points form an even lattice; no value for other grids.
std::optional<Affine> straightMapOf(vtkDataSet* grid, const std::array<int, 3>& size) {
  const auto at = [&](vtkIdType i, vtkIdType j, vtkIdType k) {
    return pointOf(grid, (k * size[1] + j) * size[0] + i);
  };
  Affine map;
  map.origin = at(0, 0, 0);
  map.linear.col(0) = (at(size[0] - 1, 0, 0) - map.origin) / (size[0] - 1);
  map.linear.col(1) = (at(0, size[1] - 1, 0) - map.origin) / (size[1] - 1);
  map.linear.col(2) = (at(0, 0, size[2] - 1) - map.origin) / (size[2] - 1);
  const double tolerance = kStraight * map.linear.colwise().norm().minCoeff();
  for (int k = 0; k < size[2]; ++k) {
    for (int j = 0; j < size[1]; ++j) {
      for (int i = 0; i < size[0]; ++i) {
        const Vec3 straight = map.linear * Vec3(i, j, k) + map.origin;
        if (!((at(i, j, k) - straight).norm() <= tolerance)) return std::nullopt;
      }
    }
  }
  return map;
}

/// Returns true for an array that numbers points or cells, which is not imported.
bool isNumbering(vtkDataSetAttributes* attributes, vtkDataArray* array) {
  return array == attributes->GetGlobalIds() || array == attributes->GetPedigreeIds();
}

/// Rejects arrays of a wrong length: VTK would read beyond the end of a short array.
void checkLengths(vtkDataSetAttributes* attributes, vtkIdType count, const std::string& file) {
  for (int a = 0; a < attributes->GetNumberOfArrays(); ++a) {
    vtkDataArray* values = attributes->GetArray(a);
    if (values == nullptr || values->GetNumberOfTuples() == count) continue;
    throw VolumeError(file,
                      fmt::format("the array \"{}\" has {} values for {} points or cells",
                                  values->GetName() == nullptr ? "" : values->GetName(),
                                  values->GetNumberOfTuples(), count),
                      "the file is damaged: export it again");
  }
}

/// Returns the arrays of points or cells, except numberings, ghost marks and VTK's mask of valid
/// points.
std::vector<Array> arraysOf(vtkDataSetAttributes* attributes) {
  std::vector<Array> arrays;
  for (int a = 0; a < attributes->GetNumberOfArrays(); ++a) {
    vtkDataArray* values = attributes->GetArray(a);
    if (values == nullptr || isNumbering(attributes, values)) continue;
    const std::string name = values->GetName() == nullptr ? "" : values->GetName();
    if (name == vtkDataSetAttributes::GhostArrayName() || name == "vtkValidPointMask") continue;
    arrays.push_back({name, valuesOf(values), "", ""});
  }
  return arrays;
}

/// Returns an array that is not 0 at points without data; empty if all have data.
Values hiddenOf(vtkDataSetAttributes* attributes, int bits) {
  auto* ghosts = vtkUnsignedCharArray::SafeDownCast(
      attributes->GetArray(vtkDataSetAttributes::GhostArrayName()));
  if (ghosts == nullptr) return {};
  Values hidden(Type::kUint8, 1, static_cast<std::size_t>(ghosts->GetNumberOfTuples()));
  auto* out = hidden.as<std::uint8_t>();
  bool any = false;
  for (vtkIdType i = 0; i < ghosts->GetNumberOfTuples(); ++i) {
    out[i] = (ghosts->GetValue(i) & bits) != 0 ? 1 : 0;
    any = any || out[i] != 0;
  }
  return any ? hidden : Values();
}

template <class Visit>
void visitCorners(const std::array<int, 3>& size, Visit visit) {
  vtkIdType cell = 0;
  for (int k = 0; k + 1 < size[2]; ++k) {
    for (int j = 0; j + 1 < size[1]; ++j) {
      for (int i = 0; i + 1 < size[0]; ++i, ++cell) {
        for (int corner = 0; corner < 8; ++corner) {
          const vtkIdType row =
              static_cast<vtkIdType>(k + corner / 4) * size[1] + j + corner / 2 % 2;
          visit(cell, row * size[0] + i + corner % 2);
        }
      }
    }
  }
}

/// Hides cells with a hidden point, and points whose cells are all hidden.
void hideBoth(Piece& image, Piece& cells) {
  const auto all = [](const Piece& piece, std::uint8_t value) {
    Values out(Type::kUint8, 1,
               static_cast<std::size_t>(piece.size[0]) * static_cast<std::size_t>(piece.size[1]) *
                   static_cast<std::size_t>(piece.size[2]));
    std::memset(out.data(), value, out.size());
    return out;
  };
  if (image.hidden.none() && cells.hidden.none()) return;
  const Values given_points = image.hidden.none() ? all(image, 0) : image.hidden;
  const Values given_cells = cells.hidden.none() ? all(cells, 0) : cells.hidden;
  image.hidden = all(image, 1);
  cells.hidden = all(cells, 0);
  const auto* hidden_points = given_points.as<std::uint8_t>();
  const auto* hidden_cells = given_cells.as<std::uint8_t>();
  auto* points = image.hidden.as<std::uint8_t>();
  auto* of_cells = cells.hidden.as<std::uint8_t>();
  visitCorners(image.size, [&](vtkIdType cell, vtkIdType point) {
    if (hidden_points[point] != 0) of_cells[cell] = 1;
    if (hidden_cells[cell] == 0) points[point] = 0;
  });
  for (std::size_t p = 0; p < given_points.size(); ++p) {
    if (hidden_points[p] != 0) points[p] = 1;
  }
  for (std::size_t c = 0; c < given_cells.size(); ++c) {
    if (hidden_cells[c] != 0) of_cells[c] = 1;
  }
}

/// Adds an image. Values of cells become a second image, at the centres of the cells.
void takeImage(vtkDataSet* data, const std::array<int, 3>& size, const Affine& map,
               const std::string& file, std::vector<Piece>& pieces) {
  checkLengths(data->GetPointData(), data->GetNumberOfPoints(), file);
  checkLengths(data->GetCellData(), data->GetNumberOfCells(), file);
  Piece image;
  image.size = size;
  image.file_from_index = map;
  image.arrays = arraysOf(data->GetPointData());
  if (*std::min_element(size.begin(), size.end()) < 2) {  // rejected later
    pieces.push_back(std::move(image));
    return;
  }
  image.hidden = hiddenOf(data->GetPointData(), vtkDataSetAttributes::HIDDENPOINT);

  Piece cells;
  cells.by_cell = true;
  cells.size = {size[0] - 1, size[1] - 1, size[2] - 1};
  cells.file_from_index = map;
  cells.file_from_index.origin += map.linear * Vec3::Constant(0.5);
  cells.hidden = hiddenOf(data->GetCellData(), vtkDataSetAttributes::HIDDENCELL);
  cells.arrays = arraysOf(data->GetCellData());
  hideBoth(image, cells);
  pieces.push_back(std::move(image));
  pieces.push_back(std::move(cells));
}

bool takeOne(vtkDataSet* data, const std::string& file, std::vector<Piece>& pieces,
             std::vector<vtkSmartPointer<vtkDataSet>>& meshes, std::vector<std::string>& notes) {
  if (data->GetNumberOfPoints() == 0) return false;
  std::array<int, 3> size{};
  if (auto* image = vtkImageData::SafeDownCast(data)) {
    image->GetDimensions(size.data());
    takeImage(data, size, mapOf(image), file, pieces);
    return true;
  }
  auto* rectilinear = vtkRectilinearGrid::SafeDownCast(data);
  auto* curvilinear = vtkStructuredGrid::SafeDownCast(data);
  if (rectilinear != nullptr || curvilinear != nullptr) {
    if (rectilinear != nullptr) {
      rectilinear->GetDimensions(size.data());
    } else {
      curvilinear->GetDimensions(size.data());
    }
    if (*std::min_element(size.begin(), size.end()) > 1) {
      if (const auto map = straightMapOf(data, size)) {
        takeImage(data, size, *map, file, pieces);
        return true;
      }
    }
  }
  checkLengths(data->GetPointData(), data->GetNumberOfPoints(), file);
  checkLengths(data->GetCellData(), data->GetNumberOfCells(), file);
  vtkSmartPointer<vtkDataSet> solid = solidCells(data, file, notes);
  if (solid == nullptr) return false;
  meshes.push_back(std::move(solid));
  return true;
}

/// Copies a mesh, and prepares the values of its cells for averages: replaces fill values by NaN,
/// and subtracts an offset from large whole numbers.
/// @param offsets  Receives the offsets, by array name.
vtkSmartPointer<vtkDataSet> prepareCells(vtkDataSet* mesh, const std::vector<std::string>& names,
                                         std::map<std::string, double>& offsets,
                                         std::vector<std::string>& notes) {
  SingleProcess alone;
  auto out = vtk::TakeSmartPointer(mesh->NewInstance());
  out->ShallowCopy(mesh);
  for (const std::string& name : names) {
    Array cells{name, valuesOf(mesh->GetCellData()->GetArray(name.c_str())), "", ""};
    const bool filled = hideFillValues(cells, notes, Shared(alone));
    std::optional<double> offset;
    subtractOffset(cells, offset, Shared(alone));
    offsets[name] = cells.value_offset;
    const Values& values = cells.values;
    if (!filled && cells.value_offset == 0.0) continue;
    vtkNew<vtkDoubleArray> array;
    array->SetName(name.c_str());
    array->SetNumberOfComponents(values.components());
    array->SetNumberOfTuples(static_cast<vtkIdType>(values.tuples()));
    for (std::size_t i = 0; i < values.tuples(); ++i) {
      for (int c = 0; c < values.components(); ++c) {
        array->SetComponent(static_cast<vtkIdType>(i), c, values.at(i, c));
      }
    }
    out->GetCellData()->AddArray(array);
  }
  return out;
}

Piece takeMesh(std::vector<vtkSmartPointer<vtkDataSet>> meshes, const std::string& file,
               std::vector<std::string>& notes) {
  vtkSmartPointer<vtkDataSet> mesh = meshes.front();
  if (meshes.size() > 1) {
    vtkNew<vtkAppendFilter> append;
    std::set<std::string> there;
    for (const auto& block : meshes) {
      append->AddInputData(block);
      for (vtkDataSetAttributes* attributes :
           {static_cast<vtkDataSetAttributes*>(block->GetPointData()),
            static_cast<vtkDataSetAttributes*>(block->GetCellData())}) {
        for (int a = 0; a < attributes->GetNumberOfArrays(); ++a) {
          if (attributes->GetArrayName(a) != nullptr) there.insert(attributes->GetArrayName(a));
        }
      }
    }
    run(append, file);
    mesh = append->GetOutput();
    notes.push_back(fmt::format("{} blocks were joined", meshes.size()));
    for (const std::string& name : there) {
      if (mesh->GetPointData()->HasArray(name.c_str()) != 0) continue;
      if (mesh->GetCellData()->HasArray(name.c_str()) != 0) continue;
      notes.push_back(fmt::format(
          "{}: skipped: some blocks lack this array, or its type or number of components differs",
          name));
    }
  }
  std::vector<std::string> moved;
  std::map<std::string, double> offsets;
  for (int a = 0; a < mesh->GetCellData()->GetNumberOfArrays(); ++a) {
    vtkDataArray* array = mesh->GetCellData()->GetArray(a);
    if (array == nullptr || isNumbering(mesh->GetCellData(), array)) continue;
    const std::string name = array->GetName() == nullptr ? "" : array->GetName();
    if (name.empty() || name == vtkDataSetAttributes::GhostArrayName()) continue;
    if (mesh->GetPointData()->HasArray(name.c_str()) == 0) {
      moved.push_back(name);
    } else {
      notes.push_back(fmt::format(
          "{}: the values per cell are skipped, because the points have an array of this name",
          name));
    }
  }
  if (!moved.empty()) {
    vtkNew<vtkCellDataToPointData> points;
    points->SetInputData(prepareCells(mesh, moved, offsets, notes));
    points->SetProcessAllArrays(false);
    for (const std::string& name : moved) points->AddCellDataArray(name.c_str());
    points->PassCellDataOn();
    run(points, file);
    mesh = vtkDataSet::SafeDownCast(points->GetOutput());
    extrapolateToBoundary(mesh, moved);
    notes.push_back(
        fmt::format("{}: one value per cell: averaged to the points, extrapolated to the boundary",
                    fmt::join(moved, ", ")));
  }
  Piece piece;
  piece.arrays = arraysOf(mesh->GetPointData());
  for (Array& array : piece.arrays) {
    if (const auto known = offsets.find(array.name); known != offsets.end()) {
      array.value_offset = known->second;
    }
  }
  piece.mesh = meshOf(mesh);
  return piece;
}

/// Finds the type by size and sign, because VTK has several names for the same integer type.
Type typeOf(vtkDataArray* values) {
  const bool is_signed = values->GetDataTypeMin() < 0.0;
  switch (values->GetDataType()) {
    case VTK_FLOAT:
      return Type::kFloat32;
    case VTK_DOUBLE:
      return Type::kFloat64;
    default:
      break;
  }
  switch (values->GetDataTypeSize()) {
    case 1:
      return is_signed ? Type::kInt8 : Type::kUint8;
    case 2:
      return is_signed ? Type::kInt16 : Type::kUint16;
    case 4:
      return is_signed ? Type::kInt32 : Type::kUint32;
    default:
      return is_signed ? Type::kInt64 : Type::kUint64;
  }
}

}  // namespace

Values valuesOf(vtkDataArray* values) {
  vtkSmartPointer<vtkDataArray> kept = values;
  if (vtkBitArray::SafeDownCast(values) != nullptr) {
    kept = vtkSmartPointer<vtkUnsignedCharArray>::New();
    kept->DeepCopy(values);
  }
  std::shared_ptr<void> data(kept->GetVoidPointer(0), [kept](void*) {});
  return {typeOf(kept), kept->GetNumberOfComponents(),
          static_cast<std::size_t>(kept->GetNumberOfTuples()), std::move(data)};
}

std::vector<Piece> piecesOf(vtkDataObject* data, const std::string& file,
                            std::vector<std::string>& notes) {
  std::vector<Piece> pieces;
  std::vector<vtkSmartPointer<vtkDataSet>> meshes;
  bool seen = false;
  if (auto* composite = vtkCompositeDataSet::SafeDownCast(data)) {
    const auto iterator = vtk::TakeSmartPointer(composite->NewIterator());
    for (iterator->InitTraversal(); !iterator->IsDoneWithTraversal(); iterator->GoToNextItem()) {
      if (auto* block = vtkDataSet::SafeDownCast(iterator->GetCurrentDataObject())) {
        seen = takeOne(block, file, pieces, meshes, notes) || seen;
      }
    }
  } else if (auto* one = vtkDataSet::SafeDownCast(data)) {
    seen = takeOne(one, file, pieces, meshes, notes);
  }
  if (!seen) {
    throw VolumeError(file, "the file has no cells with volume, or all of them are hidden",
                      "give an image or a mesh of cells with volume");
  }
  if (!meshes.empty()) pieces.push_back(takeMesh(std::move(meshes), file, notes));
  return pieces;
}

}  // namespace palpate::importer
