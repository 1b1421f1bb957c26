/// Compares an imported .vdb with VTK's own probe of the original. Prints a table row per array.
///
///   palpate_import_agreement KIND ORIGINAL VDB
///
/// KIND: vtk, exodus, headsq (a folder of slices), brainsmall or wind (raw; this file has their
/// layouts). VTK's readers, not the importer's, read the originals; palpate's samplers read the
/// .vdb. Voxel centres must agree to float precision. For meshes, random points must agree to the
/// error that the importer stated when it resampled them (metadata of the grid). The exit status is
/// 1 if values disagree.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <iterator>
#include <random>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <vtkDataSetReader.h>
#include <vtkDoubleArray.h>
#include <vtkExodusIIReader.h>
#include <vtkImageData.h>
#include <vtkImageReader2.h>
#include <vtkMultiBlockDataSet.h>
#include <vtkNew.h>
#include <vtkPointData.h>
#include <vtkPoints.h>
#include <vtkPolyData.h>
#include <vtkProbeFilter.h>
#include <vtkStructuredGrid.h>
#include <vtkUnstructuredGrid.h>
#include <vtkVolume16Reader.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/vdb_field.h"
#include "tests/support/probe.h"

namespace {

using palpate::Vec3;

/// Reads a raw file of interleaved components.
vtkSmartPointer<vtkDataSet> readRaw(const char* file, int type, const std::array<int, 3>& size,
                                    int components, unsigned long header, bool big_endian,
                                    const palpate::Mat3& axes, const char* name) {
  vtkNew<vtkImageReader2> reader;
  reader->SetFileName(file);
  reader->SetFileDimensionality(3);
  reader->SetDataScalarType(type);
  reader->SetNumberOfScalarComponents(components);
  reader->SetDataExtent(0, size[0] - 1, 0, size[1] - 1, 0, size[2] - 1);
  reader->SetHeaderSize(header);
  reader->FileLowerLeftOn();
  if (big_endian) {
    reader->SetDataByteOrderToBigEndian();
  } else {
    reader->SetDataByteOrderToLittleEndian();
  }
  reader->Update();
  // A curvilinear grid supports any axes.
  vtkNew<vtkPoints> points;
  points->SetDataTypeToDouble();
  for (int k = 0; k < size[2]; ++k) {
    for (int j = 0; j < size[1]; ++j) {
      for (int i = 0; i < size[0]; ++i) {
        const Vec3 p = axes * Vec3(i, j, k);
        points->InsertNextPoint(p.x(), p.y(), p.z());
      }
    }
  }
  auto grid = vtkSmartPointer<vtkStructuredGrid>::New();
  grid->SetDimensions(size[0], size[1], size[2]);
  grid->SetPoints(points);
  vtkDataArray* values = reader->GetOutput()->GetPointData()->GetScalars();
  values->SetName(name);
  grid->GetPointData()->AddArray(values);
  return grid;
}

vtkSmartPointer<vtkDataSet> readOriginal(const std::string& kind, const char* file) {
  if (kind == "vtk") {
    vtkNew<vtkDataSetReader> reader;
    reader->SetFileName(file);
    reader->ReadAllScalarsOn();
    reader->ReadAllVectorsOn();
    reader->Update();
    return reader->GetOutput();
  }
  if (kind == "exodus") {
    vtkNew<vtkExodusIIReader> reader;
    reader->SetFileName(file);
    reader->UpdateInformation();
    reader->SetAllArrayStatus(vtkExodusIIReader::NODAL, 1);
    reader->GenerateGlobalNodeIdArrayOff();
    reader->Update();
    auto* blocks = vtkMultiBlockDataSet::SafeDownCast(reader->GetOutput()->GetBlock(0));
    return vtkDataSet::SafeDownCast(blocks->GetBlock(0));
  }
  if (kind == "headsq") {
    vtkNew<vtkVolume16Reader> reader;
    reader->SetFilePrefix((std::string(file) + "/quarter").c_str());
    reader->SetDataDimensions(64, 64);
    reader->SetDataByteOrderToLittleEndian();
    reader->SetImageRange(1, 93);
    reader->SetDataSpacing(3.2, 3.2, 1.5);
    reader->Update();
    vtkImageData* image = reader->GetOutput();
    image->GetPointData()->GetScalars()->SetName("density");
    // This reader puts the last row at 0. In the header's left-handed space, the first row is at 0
    // and the others are at negative positions. The origin corrects this shift.
    image->SetOrigin(0.0, -63 * 3.2, 0.0);
    return image;
  }
  if (kind == "brainsmall") {
    return readRaw(file, VTK_UNSIGNED_CHAR, {128, 128, 84}, 1, 62, false, palpate::Mat3::Identity(),
                   "density");
  }
  palpate::Mat3 axes;  // the steps in wind.dx's header
  axes << 0, 0, 4166.667, 2214.286, 0, 0, 0, 4153.846, 0;
  return readRaw(file, VTK_FLOAT, {8, 14, 25}, 3, 635, true, axes, "wind");
}

/// Converts arrays to double, because VTK's probe rounds to the type of the array.
void makeDouble(vtkDataSet* data) {
  for (int a = 0; a < data->GetPointData()->GetNumberOfArrays(); ++a) {
    vtkDataArray* values = data->GetPointData()->GetArray(a);
    if (values == nullptr) continue;
    vtkNew<vtkDoubleArray> doubles;
    doubles->DeepCopy(values);
    doubles->SetName(values->GetName());
    data->GetPointData()->AddArray(doubles);  // replaces the array of this name
  }
}

/// Returns VTK's values at points; NaN where VTK has none.
std::vector<Vec3> probe(vtkDataSet* original, const std::vector<Vec3>& at, const char* name) {
  vtkNew<vtkPoints> points;
  points->SetDataTypeToDouble();
  for (const Vec3& p : at) points->InsertNextPoint(p.x(), p.y(), p.z());
  vtkNew<vtkPolyData> cloud;
  cloud->SetPoints(points);
  vtkNew<vtkProbeFilter> filter;
  filter->SetInputData(cloud);
  filter->SetSourceData(original);
  filter->Update();
  vtkDataArray* values = filter->GetOutput()->GetPointData()->GetArray(name);
  vtkDataArray* valid = filter->GetOutput()->GetPointData()->GetArray("vtkValidPointMask");
  std::vector<Vec3> out;
  for (vtkIdType i = 0; i < static_cast<vtkIdType>(at.size()); ++i) {
    Vec3 v = Vec3::Constant(std::nan(""));
    if (valid->GetTuple1(i) != 0.0) {
      v.setZero();
      for (int c = 0; c < values->GetNumberOfComponents(); ++c) v[c] = values->GetComponent(i, c);
    }
    out.push_back(v);
  }
  return out;
}

/// Returns the number of voxels with data among the 8 voxels around p.
template <class GridT>
int dataAbout(const GridT& grid, const Vec3& p) {
  const auto low = openvdb::Coord::floor(grid.worldToIndex(openvdb::Vec3d(p.x(), p.y(), p.z())));
  int count = 0;
  for (int c = 0; c < 8; ++c) {
    count += grid.tree().isValueOn(low.offsetBy(c & 1, (c >> 1) & 1, c >> 2)) ? 1 : 0;
  }
  return count;
}

struct Difference {
  double rms = 0.0;
  double largest = 0.0;
  std::size_t points = 0;
};

/// Returns differences relative to the range of the values.
template <class Reads>
Difference compare(const std::vector<Vec3>& at, const std::vector<Vec3>& truth, double range,
                   Reads read) {
  Difference out;
  for (std::size_t i = 0; i < at.size(); ++i) {
    if (!truth[i].allFinite()) continue;
    const double difference = (read(at[i]) - truth[i]).norm() / range;
    out.rms += difference * difference;
    out.largest = std::max(out.largest, difference);
    ++out.points;
  }
  if (out.points > 0) out.rms = std::sqrt(out.rms / static_cast<double>(out.points));
  return out;
}

template <class GridT>
bool agree(vtkDataSet* original, const std::string& vdb, const GridT& grid) {
  const std::string name = grid.getName();
  vtkDataArray* values = original->GetPointData()->GetArray(name.c_str());
  const double range = values->GetNumberOfComponents() == 1
                           ? values->GetRange()[1] - values->GetRange()[0]
                           : values->GetMaxNorm();
  palpate::test::Probe field(palpate::loadVolume(vdb, name));
  const auto read = [&](const Vec3& p) {
    return field.field.index() == 0 ? Vec3(field.scalar(p).value, 0.0, 0.0) : field.vector(p).value;
  };
  const auto stated = grid.template getMetadata<openvdb::DoubleMetadata>("resampling_rms");

  // Compares all points of an image, and the centres of all active voxels of a resampled mesh.
  std::vector<Vec3> centres;
  if (stated == nullptr) {
    for (vtkIdType i = 0; i < original->GetNumberOfPoints(); ++i) {
      Vec3 p;
      original->GetPoint(i, p.data());
      centres.push_back(p);
    }
  } else {
    for (auto value = grid.cbeginValueOn(); value; ++value) {
      const openvdb::Vec3d p = grid.indexToWorld(value.getCoord());
      centres.emplace_back(p.x(), p.y(), p.z());
    }
  }
  const Difference exact = compare(centres, probe(original, centres, name.c_str()), range, read);

  // Compares random points within the bounds.
  std::mt19937_64 random(7);
  double bounds[6];
  original->GetBounds(bounds);
  std::vector<Vec3> anywhere;
  while (anywhere.size() < 100000) {
    Vec3 p;
    for (int a = 0; a < 3; ++a) {
      p[a] = std::uniform_real_distribution<>(bounds[2 * a], bounds[2 * a + 1])(random);
    }
    anywhere.push_back(p);
  }
  std::vector<Vec3> beside;
  if (stated != nullptr) {
    std::copy_if(anywhere.begin(), anywhere.end(), std::back_inserter(beside), [&](const Vec3& p) {
      const int count = dataAbout(grid, p);
      return count > 0 && count < 8;
    });
    std::erase_if(anywhere, [&](const Vec3& p) { return dataAbout(grid, p) < 8; });
  }
  const Difference between =
      compare(anywhere, probe(original, anywhere, name.c_str()), range, read);
  // In the outermost voxel, samples mix data with the background.
  const Difference edge = compare(beside, probe(original, beside, name.c_str()), range, read);
  const auto stated_edge =
      grid.template getMetadata<openvdb::DoubleMetadata>("resampling_edge_rms");

  const double allowed = stated == nullptr ? 1e-6 : 1.1 * stated->value() + 1e-6;
  // Few points are in the outermost voxel, and some of them cause most of the error, so the limits
  // have a factor of 2.
  const bool edge_ok = edge.points == 0 ||
                       (stated_edge != nullptr && edge.rms <= 2.0 * stated_edge->value() + 1e-6 &&
                        edge.rms >= 0.5 * stated_edge->value() - 1e-6);
  const bool ok = exact.points > 0 && between.points > 0 && exact.largest <= 1e-6 &&
                  between.rms <= allowed && edge_ok;
  const auto told = [](const auto& number) { return fmt::format("{:.1e}", number->value()); };
  fmt::print(
      "| {} | {} | {} | {:.1e} | {} | {:.1e} | {:.1e} | {} | {} | {:.1e} | {:.1e} | {} |{}\n",
      vdb.substr(vdb.find_last_of('/') + 1), name, exact.points, exact.largest, between.points,
      between.rms, between.largest, stated == nullptr ? "exact" : told(stated), edge.points,
      edge.rms, edge.largest, stated_edge == nullptr ? "" : told(stated_edge),
      ok ? "" : " DISAGREES");
  return ok;
}

}  // namespace

int main(int argc, char** argv) try {
  if (argc != 4) return 2;
  openvdb::initialize();
  const auto original = readOriginal(argv[1], argv[2]);
  makeDouble(original);
  openvdb::io::File file(argv[3]);
  file.open(false);
  bool ok = true;
  const openvdb::GridPtrVecPtr grids = file.getGrids();
  for (const openvdb::GridBase::Ptr& grid : *grids) {
    if (grid->isType<openvdb::FloatGrid>()) {
      ok = agree(original, argv[3], *openvdb::gridPtrCast<openvdb::FloatGrid>(grid)) && ok;
    } else {
      ok = agree(original, argv[3], *openvdb::gridPtrCast<openvdb::Vec3SGrid>(grid)) && ok;
    }
  }
  return ok ? 0 : 1;
} catch (const palpate::Error& e) {
  fmt::print(stderr, "{}\n", e.what());
  return 1;
}
