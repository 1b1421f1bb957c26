/// Resamples meshes to cubic voxels. Voxels outside the mesh are inactive.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <openvdb/tools/ChangeBackground.h>
#include <openvdb/tools/Interpolation.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <vtkGenericCell.h>
#include <vtkIdList.h>
#include <vtkNew.h>
#include <vtkPoints.h>
#include <vtkStaticCellLocator.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/differences.h"
#include "palpate/scenes/apps/import/grids.h"
#include "palpate/scenes/apps/import/mesh.h"
#include "palpate/scenes/apps/import/quantile.h"
#include "palpate/scenes/apps/import/resample.h"
#include "palpate/scenes/apps/import/shared_progress.h"

namespace palpate::importer {
namespace {

using openvdb::Coord;
using openvdb::Vec3d;
using ScalarTree = openvdb::FloatTree;
using VectorTree = openvdb::Vec3STree;

/// Tolerance for the outermost voxels, which lie on the mesh's bounds: in parametric coordinates of
/// a cell, or in voxels.
constexpr double kOutside = 1e-5;

/// VTK stores bounds axis by axis, first the lower one.
double low(const double bounds[6], int axis) {
  return bounds[static_cast<std::ptrdiff_t>(2) * axis];
}
double high(const double bounds[6], int axis) {
  return bounds[static_cast<std::ptrdiff_t>(2) * axis + 1];
}
double volumeOf(const double bounds[6]) {
  return (bounds[1] - bounds[0]) * (bounds[3] - bounds[2]) * (bounds[5] - bounds[4]);
}

/// Data of one thread. VTK writes into `cell` when it locates a point.
struct Worker {
  vtkNew<vtkGenericCell> cell;
  vtkNew<vtkIdList> candidates;
  std::vector<double> weights;
};

/// Computes the weights of the cell's points at p. Returns false if p is outside the cell.
bool weighAt(const Vec3d& p, Worker& worker) {
  worker.weights.resize(static_cast<std::size_t>(worker.cell->GetNumberOfPoints()));
  double x[3] = {p.x(), p.y(), p.z()};
  double closest[3];
  double parametric[3];
  double distance2 = 0.0;
  int part = 0;
  const int found =
      worker.cell->EvaluatePosition(x, closest, part, parametric, distance2, worker.weights.data());
  if (found < 0 || !isInsideCell(worker.cell->GetCellType(), parametric, kOutside)) return false;
  // Slightly outside a cell, VTK computes the weights only for some types of cells.
  if (found == 0) worker.cell->InterpolateFunctions(parametric, worker.weights.data());
  return true;
}

bool findCell(vtkDataSet* mesh, vtkStaticCellLocator* locator, const Vec3d& p, Worker& worker) {
  double box[6] = {p.x(), p.x(), p.y(), p.y(), p.z(), p.z()};
  locator->FindCellsWithinBounds(box, worker.candidates);
  worker.candidates->Sort();
  for (vtkIdType c = 0; c < worker.candidates->GetNumberOfIds(); ++c) {
    mesh->GetCell(worker.candidates->GetId(c), worker.cell);
    if (weighAt(p, worker)) return true;
  }
  return false;
}

double valueAt(const Worker& worker, const Values& values, int component) {
  double sum = 0.0;
  for (std::size_t i = 0; i < worker.weights.size(); ++i) {
    const vtkIdType point = worker.cell->GetPointId(static_cast<vtkIdType>(i));
    sum += worker.weights[i] * values.at(static_cast<std::size_t>(point), component);
  }
  return sum;
}

class Sheet {
 public:
  explicit Sheet(const Array& array) : array_(&array), vector_(array.values.components() == 3) {}

  using ScalarLeaf = ScalarTree::LeafNodeType;
  using VectorLeaf = VectorTree::LeafNodeType;
  struct Leaf {
    std::unique_ptr<ScalarLeaf> scalar;
    std::unique_ptr<VectorLeaf> vector;
  };

  [[nodiscard]] Leaf makeLeaf(const Coord& origin) const {
    Leaf leaf;
    if (vector_) {
      leaf.vector = std::make_unique<VectorLeaf>(origin);
    } else {
      leaf.scalar = std::make_unique<ScalarLeaf>(origin);
    }
    return leaf;
  }

  /// Sets a voxel. Returns false, and leaves it without data, if the value is not finite.
  [[nodiscard]] bool set(Leaf& leaf, unsigned offset, const Worker& worker) const {
    if (vector_) {
      openvdb::Vec3f v;
      for (int c = 0; c < 3; ++c) v[c] = static_cast<float>(valueAt(worker, array_->values, c));
      if (!v.isFinite()) return false;
      leaf.vector->setValueOn(offset, v);
    } else {
      const auto v = static_cast<float>(valueAt(worker, array_->values, 0));
      if (!std::isfinite(v)) return false;
      leaf.scalar->setValueOn(offset, v);
    }
    return true;
  }

  [[nodiscard]] const Array& array() const { return *array_; }
  [[nodiscard]] bool isVector() const { return vector_; }

 private:
  const Array* array_;
  bool vector_;
};

/// Returns the median of the active values beside inactive voxels.
float edgeValue(const openvdb::FloatGrid& grid) {
  std::vector<float> edge;
  const auto accessor = grid.getConstAccessor();
  for (auto value = grid.cbeginValueOn(); value; ++value) {
    const Coord at = value.getCoord();
    for (int a = 0; a < 6; ++a) {
      Coord beside = at;
      beside[a / 2] += a % 2 == 0 ? 1 : -1;
      if (accessor.isValueOn(beside)) continue;
      edge.push_back(*value);
      break;
    }
  }
  return quantile(edge, 0.5);
}

template <class GridT>
void takeRange(const GridT& grid, Gridded& made) {
  made.lowest = std::numeric_limits<double>::infinity();
  made.highest = -made.lowest;
  for (auto value = grid.cbeginValueOn(); value; ++value) {
    const double size = lengthOf(*value);
    made.lowest = std::min(made.lowest, size);
    made.highest = std::max(made.highest, size);
  }
}

template <class Accessor>
int dataAbout(const Accessor& accessor, const Vec3d& p_I) {
  const Coord low = Coord::floor(p_I);
  int count = 0;
  for (int corner = 0; corner < 8; ++corner) {
    count += accessor.isValueOn(low.offsetBy(corner & 1, (corner >> 1) & 1, corner >> 2)) ? 1 : 0;
  }
  return count;
}

/// Returns all cells; if there are more than 20,000, a random sample that is the same in every run.
std::vector<vtkIdType> someCells(vtkIdType cells) {
  constexpr vtkIdType kMost = 20000;
  std::vector<vtkIdType> some;
  if (cells <= kMost) {
    for (vtkIdType i = 0; i < cells; ++i) some.push_back(i);
  } else {
    std::mt19937_64 random(1);
    std::uniform_int_distribution<vtkIdType> any(0, cells - 1);
    for (vtkIdType i = 0; i < kMost; ++i) some.push_back(any(random));
  }
  return some;
}

struct Place {
  Vec3d p;
  std::vector<std::pair<std::size_t, double>> weights;

  [[nodiscard]] double valueOf(const Values& values, int component) const {
    double sum = 0.0;
    for (const auto& [point, weight] : weights) {
      sum += weight * values.at(point, component);
    }
    return sum;
  }
};

/// Returns random points inside the mesh, used for all arrays.
std::vector<Place> somePlaces(vtkDataSet* mesh, vtkStaticCellLocator* locator) {
  constexpr int kCount = 50000;
  std::mt19937_64 random(2);
  double bounds[6];
  mesh->GetBounds(bounds);
  Worker worker;
  std::vector<Place> places;
  for (int i = 0; i < kCount; ++i) {
    Place place;
    for (int a = 0; a < 3; ++a) {
      place.p[a] = std::uniform_real_distribution<>(low(bounds, a), high(bounds, a))(random);
    }
    if (!findCell(mesh, locator, place.p, worker)) continue;
    for (std::size_t w = 0; w < worker.weights.size(); ++w) {
      const vtkIdType point = worker.cell->GetPointId(static_cast<vtkIdType>(w));
      place.weights.emplace_back(static_cast<std::size_t>(point), worker.weights[w]);
    }
    places.push_back(std::move(place));
  }
  return places;
}

template <class GridT>
Differences compare(const std::vector<Place>& places, const Values& values, const GridT& grid) {
  Differences differences;
  const auto accessor = grid.getConstAccessor();
  for (const Place& place : places) {
    Vec3d v(0.0);
    for (int c = 0; c < values.components(); ++c) v[c] = place.valueOf(values, c);
    if (!v.isFinite()) continue;  // the original has no data there
    const Vec3d p_I = grid.worldToIndex(place.p);
    const int data = dataAbout(accessor, p_I);
    if (data == 0) {
      ++differences.lost_points;
      continue;
    }
    Differences::Sum& sum = data == 8 ? differences.within : differences.edge;
    const auto there = openvdb::tools::BoxSampler::sample(accessor, p_I);
    if constexpr (std::is_same_v<GridT, openvdb::FloatGrid>) {
      sum.add(std::abs(v.x() - static_cast<double>(there)));
    } else {
      sum.add((v - Vec3d(there)).length());
    }
  }
  return differences;
}

/// Returns the volume of a cell: the sum of the tetrahedra into which VTK divides it.
double solidVolume(vtkCell* cell, vtkIdList* points, vtkPoints* corners) {
  cell->Triangulate(0, points, corners);
  double volume = 0.0;
  for (vtkIdType t = 0; t + 3 < corners->GetNumberOfPoints(); t += 4) {
    std::array<Vec3d, 4> p;
    for (vtkIdType c = 0; c < 4; ++c) {
      corners->GetPoint(t + c, p[static_cast<std::size_t>(c)].asPointer());
    }
    volume += std::abs((p[1] - p[0]).dot((p[2] - p[0]).cross(p[3] - p[0]))) / 6.0;
  }
  return volume;
}

/// Rounds to two digits, so that the number is easy to type.
double twoDigits(double x, double (*to_whole)(double)) {
  const double digit = std::pow(10.0, std::floor(std::log10(x)) - 1.0);
  return to_whole(x / digit) * digit;
}

SuggestedVoxel suggestFor(vtkDataSet* mesh) {
  vtkNew<vtkGenericCell> cell;
  vtkNew<vtkIdList> ids;
  vtkNew<vtkPoints> corners;
  corners->SetDataTypeToDouble();
  std::vector<double> volumes;
  double solid = 0.0;
  const std::vector<vtkIdType> some = someCells(mesh->GetNumberOfCells());
  for (const vtkIdType index : some) {
    mesh->GetCell(index, cell);
    double bounds[6];
    cell->GetBounds(bounds);
    volumes.push_back(volumeOf(bounds));
    solid += solidVolume(cell, ids, corners);
  }
  double bounds[6];
  mesh->GetBounds(bounds);
  const double longest =
      std::max({bounds[1] - bounds[0], bounds[3] - bounds[2], bounds[5] - bounds[4]});
  if (volumes.empty()) return {longest / 64.0, longest / 64.0, 0.0};
  SuggestedVoxel out;
  out.by_cell = twoDigits(
      std::clamp(0.5 * std::cbrt(quantile(volumes, 0.5)), longest / 512.0, longest / 32.0),
      [](double x) { return std::round(x); });
  // Scales the volume of the sample to all cells, to find the fraction of voxels in the mesh.
  solid *= static_cast<double>(mesh->GetNumberOfCells()) / static_cast<double>(some.size());
  const auto voxels_of = [&](double edge) {
    double count = std::min(solid / volumeOf(bounds), 1.0);
    for (int a = 0; a < 3; ++a)
      count *= std::floor((high(bounds, a) - low(bounds, a)) / edge) + 1.0;
    return count;
  };
  out.voxels_by_cell = voxels_of(out.by_cell);
  constexpr double kLeast = 33.0 * 33.0 * 33.0;
  const double most =
      std::max(kVoxelsPerPoint * static_cast<double>(mesh->GetNumberOfPoints()), kLeast);
  out.edge = out.by_cell;
  constexpr double kStep = 1.01;
  while (voxels_of(out.edge) > most) {
    out.edge = twoDigits(out.edge * kStep, [](double x) { return std::ceil(x); });
  }
  return out;
}

class MeshResampler {
 public:
  MeshResampler(vtkDataSet* mesh, const std::vector<Array>& arrays, double voxel,
                const std::string& file)
      : mesh_(mesh), file_(file), voxel_(voxel), holes_(arrays.size()) {
    // VTK computes data of the mesh in the first calls; later calls, on several threads, only read.
    mesh->ComputeBounds();
    mesh->GetCell(0, vtkNew<vtkGenericCell>());
    mesh->GetBounds(bounds_);
    size_ = countCubes({bounds_[1] - bounds_[0], bounds_[3] - bounds_[2], bounds_[5] - bounds_[4]},
                       voxel, kOutside, file);
    transform_ = cubes(voxel, Vec3d(bounds_[0], bounds_[2], bounds_[4]), file);
    locator_->SetDataSet(mesh);
    locator_->CacheCellBoundsOn();
    locator_->BuildLocator();
    sheets_.reserve(arrays.size());
    for (const Array& array : arrays) sheets_.emplace_back(array);
  }

  std::vector<Resampled> run(const Progress& progress) {
    fillLeaves(progress);
    const std::vector<Place> places = somePlaces(mesh_, locator_);
    std::vector<Resampled> out;
    for (std::size_t s = 0; s < sheets_.size(); ++s) {
      out.push_back(sheets_[s].isVector()
                        ? finish(
                              openvdb::Vec3SGrid::create(), s, places,
                              [](Sheet::Leaf & leaf) -> auto& { return leaf.vector; })
                        : finish(
                              openvdb::FloatGrid::create(), s, places,
                              [](Sheet::Leaf & leaf) -> auto& { return leaf.scalar; }));
    }
    return out;
  }

 private:
  static constexpr int kEdge = 8;

  void fillLeaves(const Progress& progress) {
    const std::array<int, 3> leaves{(size_[0] + kEdge - 1) / kEdge, (size_[1] + kEdge - 1) / kEdge,
                                    (size_[2] + kEdge - 1) / kEdge};
    const int rows = leaves[1] * leaves[2];
    made_.resize(static_cast<std::size_t>(rows));
    SharedProgress shared(progress, rows);
    tbb::enumerable_thread_specific<Worker> workers;
    tbb::parallel_for(0, rows, [&](int row) {
      Worker& worker = workers.local();
      for (int x = 0; x < leaves[0]; ++x) {
        const Coord origin(x * kEdge, (row % leaves[1]) * kEdge, (row / leaves[1]) * kEdge);
        std::vector<Sheet::Leaf> here = fillLeaf(origin, worker);
        if (!here.empty()) made_[static_cast<std::size_t>(row)].push_back(std::move(here));
      }
      shared.step();
    });
  }

  /// Returns a leaf for each grid; empty if no cell reaches the leaf's voxels.
  std::vector<Sheet::Leaf> fillLeaf(const Coord& origin, Worker& worker) {
    const Vec3d lower = transform_->indexToWorld(origin.asVec3d() - Vec3d(kOutside));
    const Vec3d upper = transform_->indexToWorld(origin.asVec3d() + Vec3d(kEdge - 1 + kOutside));
    double box[6] = {lower.x(), upper.x(), lower.y(), upper.y(), lower.z(), upper.z()};
    locator_->FindCellsWithinBounds(box, worker.candidates);
    std::vector<Sheet::Leaf> here;
    if (worker.candidates->GetNumberOfIds() == 0) return here;
    // sorts, so that the choice among several cells at a voxel does not depend on the locator
    worker.candidates->Sort();

    openvdb::util::NodeMask<3> taken;
    for (vtkIdType c = 0; c < worker.candidates->GetNumberOfIds(); ++c) {
      mesh_->GetCell(worker.candidates->GetId(c), worker.cell);
      const openvdb::CoordBBox voxels = voxelsOf(worker, origin);
      if (voxels.empty()) continue;
      for (auto at = voxels.begin(); at; ++at) {
        const unsigned offset = ScalarTree::LeafNodeType::coordToOffset(*at);
        if (taken.isOn(offset)) continue;
        if (!weighAt(transform_->indexToWorld(*at), worker)) continue;
        taken.setOn(offset);
        if (here.empty()) {
          for (const Sheet& sheet : sheets_) here.push_back(sheet.makeLeaf(origin));
        }
        for (std::size_t s = 0; s < sheets_.size(); ++s) {
          if (!sheets_[s].set(here[s], offset, worker)) ++holes_[s];
        }
      }
    }
    inside_ += taken.countOn();
    return here;
  }

  [[nodiscard]] openvdb::CoordBBox voxelsOf(Worker& worker, const Coord& origin) const {
    double cell[6];
    worker.cell->GetBounds(cell);
    openvdb::CoordBBox box;
    for (int a = 0; a < 3; ++a) {
      const double from = (low(cell, a) - low(bounds_, a)) / voxel_;
      const double to = (high(cell, a) - low(bounds_, a)) / voxel_;
      box.min()[a] = std::max(origin[a], static_cast<int>(std::ceil(from - kOutside)));
      box.max()[a] = std::min({origin[a] + kEdge - 1, size_[static_cast<std::size_t>(a)] - 1,
                               static_cast<int>(std::floor(to + kOutside))});
    }
    return box;
  }

  template <class GridPtr, class LeafOf>
  Resampled finish(const GridPtr& grid, std::size_t s, const std::vector<Place>& places,
                   LeafOf leaf_of) {
    const Sheet& sheet = sheets_[s];
    Resampled one;
    one.made.voxels = inside_;
    one.made.holes = holes_[s];
    for (auto& row : made_) {
      for (auto& leaf : row) {
        if (auto& own = leaf_of(leaf[s]); !own->isEmpty()) grid->tree().addLeaf(own.release());
      }
    }
    grid->setTransform(transform_->copy());
    takeRange(*grid, one.made);
    // Sets the background to a typical value, which interpolation beside voxels without data reads.
    if constexpr (std::is_same_v<std::decay_t<decltype(*grid)>, openvdb::FloatGrid>) {
      one.made.background = edgeValue(*grid);
      openvdb::tools::changeBackground(grid->tree(), static_cast<float>(one.made.background));
    }
    const Differences differences = compare(places, sheet.array().values, *grid);
    const double range = sheet.isVector() ? one.made.highest : one.made.highest - one.made.lowest;
    one.error = differences.relativeTo(range);
    grid->setName(sheet.array().name);
    one.made.grid = grid;
    if (grid->empty()) {
      throw VolumeError(
          file_,
          fmt::format("no voxel with an edge of {:g}, in the file's unit, has its "
                      "centre in the part of the mesh where {} has data",
                      voxel_, sheet.array().name),
          "give a smaller --voxel, without --iso, or choose arrays with data by --field");
    }
    return one;
  }

  vtkDataSet* mesh_;
  const std::string& file_;
  double voxel_;
  double bounds_[6] = {};
  std::array<int, 3> size_{};
  openvdb::math::Transform::Ptr transform_;
  vtkNew<vtkStaticCellLocator> locator_;
  std::vector<Sheet> sheets_;
  std::vector<std::vector<std::vector<Sheet::Leaf>>>
      made_;  ///< Leaves, by row along x, leaf and sheet.
  /// For each array, number of voxels in the mesh whose values are not finite.
  std::vector<std::atomic<std::uint64_t>> holes_;
  std::atomic<std::uint64_t> inside_{0};
};

class VtkMesh final : public Mesh {
 public:
  explicit VtkMesh(vtkDataSet* mesh) : mesh_(mesh) {}

  [[nodiscard]] SuggestedVoxel suggestVoxel() const override { return suggestFor(mesh_); }
  [[nodiscard]] std::vector<Resampled> resample(const std::vector<Array>& arrays, double voxel,
                                                const std::string& file,
                                                const Progress& progress) const override {
    return MeshResampler(mesh_, arrays, voxel, file).run(progress);
  }

 private:
  vtkSmartPointer<vtkDataSet> mesh_;
};

}  // namespace

std::shared_ptr<const Mesh> meshOf(vtkDataSet* mesh) {
  return std::make_shared<VtkMesh>(mesh);
}

}  // namespace palpate::importer
