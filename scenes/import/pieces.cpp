#include "palpate/scenes/import/pieces.h"

#include <algorithm>
#include <cmath>
#include <set>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>
#include <vtkAppendFilter.h>
#include <vtkBitArray.h>
#include <vtkCellData.h>
#include <vtkCellDataToPointData.h>
#include <vtkCompositeDataIterator.h>
#include <vtkCompositeDataSet.h>
#include <vtkDataSetAttributes.h>
#include <vtkFloatArray.h>
#include <vtkImageData.h>
#include <vtkMatrix4x4.h>
#include <vtkNew.h>
#include <vtkPointData.h>
#include <vtkPolyData.h>
#include <vtkRectilinearGrid.h>
#include <vtkStructuredGrid.h>
#include <vtkUnstructuredGrid.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/import/mesh.h"
#include "palpate/scenes/import/tensors.h"
#include "palpate/scenes/import/vtk_run.h"

namespace palpate::importer {
namespace {

/// Points stand as an image's if none is farther than this from its place there, in edges.
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
  // The first point's index need not be 0.
  const int* extent = image->GetExtent();
  map.origin += map.linear * Vec3(extent[0], extent[2], extent[4]);
  return map;
}

/// The map of a rectilinear or curvilinear grid whose points stand as an image's.
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

/// Arrays that number points or cells, as Exodus has them, are nothing to feel.
bool isNumbering(vtkDataSetAttributes* attributes, vtkDataArray* array) {
  return array == attributes->GetGlobalIds() || array == attributes->GetPedigreeIds();
}

vtkSmartPointer<vtkDataArray> withThree(vtkDataArray* two) {
  auto out = vtkSmartPointer<vtkFloatArray>::New();
  out->SetNumberOfComponents(3);
  out->SetNumberOfTuples(two->GetNumberOfTuples());
  for (vtkIdType i = 0; i < two->GetNumberOfTuples(); ++i) {
    out->SetTuple3(i, two->GetComponent(i, 0), two->GetComponent(i, 1), 0.0);
  }
  return out;
}

/// VTK's readers take an array of any length, and it is read to the length that it should have.
void checkLengths(vtkDataSetAttributes* attributes, vtkIdType count, const std::string& file) {
  for (int a = 0; a < attributes->GetNumberOfArrays(); ++a) {
    vtkDataArray* values = attributes->GetArray(a);
    if (values == nullptr || values->GetNumberOfTuples() == count) continue;
    throw VolumeError(file,
                      fmt::format("its array \"{}\" has {} values for {} places",
                                  values->GetName() == nullptr ? "" : values->GetName(),
                                  values->GetNumberOfTuples(), count),
                      "it is damaged: export it again");
  }
}

/// A name as grids can have it: UTF-8 as far as it goes, no controls, not too long.
std::string nameOf(vtkDataArray* values, std::vector<std::string>& notes) {
  std::string name = values->GetName() == nullptr ? "" : values->GetName();
  name.erase(name.find_last_not_of(' ') + 1);  // Exodus pads
  const std::string given = name;
  constexpr std::size_t kLongest = 100;
  if (name.size() > kLongest) name.resize(kLongest);
  // What is no UTF-8 makes nlohmann-json throw: then all that is not ASCII goes.
  bool plain = true;
  try {
    (void)nlohmann::json(name).dump();
  } catch (const nlohmann::json::exception&) {
    plain = false;
  }
  for (char& c : name) {
    const auto u = static_cast<unsigned char>(c);
    if (u < 0x20 || u == 0x7f || (!plain && u > 0x7f)) c = '_';
  }
  if (name != given) notes.push_back(fmt::format("an array's name became \"{}\"", name));
  return name.empty() ? "density" : name;
}

/// The arrays of a piece's points, made ready; takes them out of `attributes`. Tensors become what
/// can be felt of them, in images only: directions cannot be interpolated within a mesh's cells.
std::vector<Array> takeArrays(vtkDataSetAttributes* attributes, const Content& content, bool image,
                              std::vector<std::string>& notes) {
  std::vector<Array> arrays;
  for (int a = 0; a < attributes->GetNumberOfArrays(); ++a) {
    vtkSmartPointer<vtkDataArray> values = attributes->GetArray(a);
    if (values == nullptr || isNumbering(attributes, values)) continue;
    const std::string given = values->GetName() == nullptr ? "" : values->GetName();
    if (given == vtkDataSetAttributes::GhostArrayName() || given == "vtkValidPointMask") continue;
    const std::string name = nameOf(values, notes);
    const auto known = content.value_unit.find(name);
    const std::string unit = known == content.value_unit.end() ? "" : known->second;
    if (vtkBitArray::SafeDownCast(values) != nullptr) {
      auto bytes = vtkSmartPointer<vtkUnsignedCharArray>::New();
      bytes->DeepCopy(values);
      values = bytes;
    }
    switch (values->GetNumberOfComponents()) {
      case 1:
      case 3:
        arrays.push_back({name, values, unit, "", false});
        break;
      case 2:
        arrays.push_back({name, withThree(values), unit, "", false});
        notes.push_back(fmt::format("{}: two components, z is 0", name));
        break;
      case 6:
      case 9:
        if (image) {
          for (Array& array : diffusionOf(Array{name, values, unit, "", false})) {
            arrays.push_back(std::move(array));
          }
          notes.push_back(fmt::format(
              "{0}: tensors: as {0}_direction (its sign means nothing), {0}_anisotropy and "
              "{0}_diffusivity",
              name));
          break;
        }
        [[fallthrough]];
      default:
        notes.push_back(
            fmt::format("{}: left out: {} values a point", name, values->GetNumberOfComponents()));
    }
  }
  for (int a = attributes->GetNumberOfArrays() - 1; a >= 0; --a) attributes->RemoveArray(a);
  return arrays;
}

/// Points or cells without data.
vtkSmartPointer<vtkUnsignedCharArray> hiddenOf(vtkDataSetAttributes* attributes, int bits) {
  auto* ghosts = vtkUnsignedCharArray::SafeDownCast(
      attributes->GetArray(vtkDataSetAttributes::GhostArrayName()));
  if (ghosts == nullptr) return nullptr;
  auto hidden = vtkSmartPointer<vtkUnsignedCharArray>::New();
  hidden->SetNumberOfValues(ghosts->GetNumberOfTuples());
  bool any = false;
  for (vtkIdType i = 0; i < ghosts->GetNumberOfTuples(); ++i) {
    const bool here = (ghosts->GetValue(i) & bits) != 0;
    hidden->SetValue(i, here ? 1 : 0);
    any = any || here;
  }
  return any ? hidden : nullptr;
}

/// Calls with each cell's number and each of its corners' numbers.
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

/// A cell at a hidden point has no data, and neither has a point of hidden cells only.
void hideBoth(Piece& image, Piece& cells) {
  const auto zeros = [](const Piece& piece) {
    auto out = vtkSmartPointer<vtkUnsignedCharArray>::New();
    out->SetNumberOfValues(static_cast<vtkIdType>(piece.size[0]) * piece.size[1] * piece.size[2]);
    out->Fill(0);
    return out;
  };
  if (image.hidden == nullptr && cells.hidden == nullptr) return;
  const auto given_points = image.hidden == nullptr ? zeros(image) : image.hidden;
  const auto given_cells = cells.hidden == nullptr ? zeros(cells) : cells.hidden;
  image.hidden = zeros(image);
  image.hidden->Fill(1);
  cells.hidden = zeros(cells);
  visitCorners(image.size, [&](vtkIdType cell, vtkIdType point) {
    if (given_points->GetValue(point) != 0) cells.hidden->SetValue(cell, 1);
    if (given_cells->GetValue(cell) == 0) image.hidden->SetValue(point, 0);
  });
  for (vtkIdType p = 0; p < given_points->GetNumberOfValues(); ++p) {
    if (given_points->GetValue(p) != 0) image.hidden->SetValue(p, 1);
  }
  for (vtkIdType c = 0; c < given_cells->GetNumberOfValues(); ++c) {
    if (given_cells->GetValue(c) != 0) cells.hidden->SetValue(c, 1);
  }
}

/// An image, and another of its cells' centres where the cells have data.
void takeImage(vtkDataSet* data, const std::array<int, 3>& size, const Affine& map,
               const Content& content, const std::string& file, std::vector<Piece>& pieces,
               std::vector<std::string>& notes) {
  if (*std::min_element(size.begin(), size.end()) < 2) {
    throw VolumeError(file, fmt::format("it is flat: {} points", fmt::join(size, " x ")),
                      "give an image with thickness");
  }
  checkLengths(data->GetPointData(), data->GetNumberOfPoints(), file);
  checkLengths(data->GetCellData(), data->GetNumberOfCells(), file);
  Piece image;
  image.size = size;
  image.file_from_index = map;
  image.hidden = hiddenOf(data->GetPointData(), vtkDataSetAttributes::HIDDENPOINT);
  image.arrays = takeArrays(data->GetPointData(), content, true, notes);

  Piece cells;
  cells.size = {size[0] - 1, size[1] - 1, size[2] - 1};
  cells.file_from_index = map;
  cells.file_from_index.origin += map.linear * Vec3::Constant(0.5);
  cells.hidden = hiddenOf(data->GetCellData(), vtkDataSetAttributes::HIDDENCELL);
  cells.arrays = takeArrays(data->GetCellData(), content, true, notes);
  hideBoth(image, cells);
  for (Array& array : cells.arrays) {
    notes.push_back(fmt::format("{}: a value a cell: its voxels are the cells", array.name));
  }
  if (!image.arrays.empty()) pieces.push_back(std::move(image));
  if (!cells.arrays.empty()) pieces.push_back(std::move(cells));
}

/// Adds one data set, meshes are collected; false if it has no volume.
bool takeOne(vtkDataSet* data, const Content& content, const std::string& file,
             std::vector<Piece>& pieces, std::vector<vtkSmartPointer<vtkDataSet>>& meshes,
             std::vector<std::string>& notes) {
  if (data->GetNumberOfPoints() == 0) return false;
  std::array<int, 3> size{};
  if (auto* image = vtkImageData::SafeDownCast(data)) {
    image->GetDimensions(size.data());
    takeImage(data, size, content.file_from_index.value_or(mapOf(image)), content, file, pieces,
              notes);
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
        takeImage(data, size, *map, content, file, pieces, notes);
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

/// All blocks as one, cell data at the points.
Piece takeMesh(std::vector<vtkSmartPointer<vtkDataSet>> meshes, const Content& content,
               const std::string& file, std::vector<std::string>& notes) {
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
    notes.push_back(fmt::format("{} blocks as one", meshes.size()));
    for (const std::string& name : there) {
      if (mesh->GetPointData()->HasArray(name.c_str()) != 0) continue;
      if (mesh->GetCellData()->HasArray(name.c_str()) != 0) continue;
      notes.push_back(fmt::format("{}: left out: not in all blocks", name));
    }
  }
  std::vector<std::string> moved;
  for (int a = 0; a < mesh->GetCellData()->GetNumberOfArrays(); ++a) {
    vtkDataArray* array = mesh->GetCellData()->GetArray(a);
    if (array == nullptr || isNumbering(mesh->GetCellData(), array)) continue;
    const std::string name = array->GetName() == nullptr ? "" : array->GetName();
    if (name.empty() || name == vtkDataSetAttributes::GhostArrayName()) continue;
    if (mesh->GetPointData()->HasArray(name.c_str()) == 0) {
      moved.push_back(name);
    } else {
      notes.push_back(
          fmt::format("{}: its values by cell are left out: points have their own", name));
    }
  }
  if (!moved.empty()) {
    vtkNew<vtkCellDataToPointData> points;
    points->SetInputData(mesh);
    points->SetProcessAllArrays(false);
    for (const std::string& name : moved) points->AddCellDataArray(name.c_str());
    points->PassCellDataOn();
    run(points, file);
    mesh = vtkDataSet::SafeDownCast(points->GetOutput());
    notes.push_back(
        fmt::format("{}: a value a cell: averaged to the points", fmt::join(moved, ", ")));
  }
  Piece piece;
  piece.mesh = mesh;
  piece.arrays = takeArrays(mesh->GetPointData(), content, false, notes);
  return piece;
}

std::vector<std::string> namesOf(const std::vector<Piece>& pieces) {
  std::vector<std::string> names;
  for (const Piece& piece : pieces) {
    for (const Array& array : piece.arrays) names.push_back(array.name);
  }
  return names;
}

}  // namespace

std::vector<Piece> takeApart(const Content& content, const std::string& file,
                             std::vector<std::string>& notes) {
  std::vector<Piece> pieces;
  std::vector<vtkSmartPointer<vtkDataSet>> meshes;
  bool seen = false;  // a volume, with arrays or without
  if (auto* composite = vtkCompositeDataSet::SafeDownCast(content.data)) {
    const auto iterator = vtk::TakeSmartPointer(composite->NewIterator());
    for (iterator->InitTraversal(); !iterator->IsDoneWithTraversal(); iterator->GoToNextItem()) {
      if (auto* block = vtkDataSet::SafeDownCast(iterator->GetCurrentDataObject())) {
        seen = takeOne(block, content, file, pieces, meshes, notes) || seen;
      }
    }
  } else if (auto* data = vtkDataSet::SafeDownCast(content.data)) {
    seen = takeOne(data, content, file, pieces, meshes, notes);
  }
  if (pieces.empty() && meshes.empty() && !seen) {
    throw VolumeError(file, "there is no volume in it, only points, lines or surfaces, or nothing",
                      "give an image or a mesh of cells with volume");
  }
  if (!meshes.empty()) pieces.push_back(takeMesh(std::move(meshes), content, file, notes));
  // One name, one grid.
  std::set<std::string> taken;
  for (Piece& piece : pieces) {
    for (Array& array : piece.arrays) {
      std::string name = array.name;
      for (int n = 2; !taken.insert(name).second; ++n) name = fmt::format("{}_{}", array.name, n);
      array.given = array.name;
      array.name = name;
    }
  }
  if (taken.empty()) {
    throw VolumeError(file, "it has no array of one or three values a point",
                      "export the values with the mesh");
  }
  return pieces;
}

void select(std::vector<Piece>& pieces, const std::vector<std::string>& fields,
            const std::string& file) {
  if (fields.empty()) return;
  const std::vector<std::string> names = namesOf(pieces);
  for (const std::string& field : fields) {
    if (std::find(names.begin(), names.end(), field) == names.end()) {
      throw VolumeError(file, fmt::format("it has no array \"{}\"", field),
                        fmt::format("it has {}", fmt::join(names, ", ")));
    }
  }
  for (Piece& piece : pieces) {
    std::erase_if(piece.arrays, [&](const Array& array) {
      return std::find(fields.begin(), fields.end(), array.name) == fields.end() &&
             std::find(fields.begin(), fields.end(), array.given) == fields.end();
    });
  }
  std::erase_if(pieces, [](const Piece& piece) { return piece.arrays.empty(); });
}

}  // namespace palpate::importer
