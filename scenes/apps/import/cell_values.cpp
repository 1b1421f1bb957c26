#include "palpate/scenes/apps/import/cell_values.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include <Eigen/Dense>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <vtkCellData.h>
#include <vtkDataArray.h>
#include <vtkIdList.h>
#include <vtkNew.h>
#include <vtkPointData.h>

#include "palpate/engine/types.h"

namespace palpate::importer {
namespace {

using Cells = std::vector<vtkIdType>;

/// Values of the cells, their averages at the points, and the range of a scalar's cell values. The
/// range of a vector is unlimited.
struct Moved {
  vtkDataArray* cells = nullptr;
  vtkDataArray* points = nullptr;
  double lowest = -std::numeric_limits<double>::infinity();
  double highest = std::numeric_limits<double>::infinity();
};

std::vector<Moved> movedOf(vtkDataSet* mesh, const std::vector<std::string>& names) {
  std::vector<Moved> out;
  for (const std::string& name : names) {
    Moved one{mesh->GetCellData()->GetArray(name.c_str()),
              mesh->GetPointData()->GetArray(name.c_str())};
    if (one.cells == nullptr || one.points == nullptr) continue;
    const int type = one.points->GetDataType();
    if (type != VTK_FLOAT && type != VTK_DOUBLE) continue;
    if (one.cells->GetNumberOfComponents() == 1) {
      std::array<double, 2> range{};
      one.cells->GetFiniteRange(range.data(), 0);
      one.lowest = range[0];
      one.highest = range[1];
    }
    out.push_back(one);
  }
  return out;
}

std::vector<Vec3> centresOf(vtkDataSet* mesh) {
  std::vector<Vec3> centres(static_cast<std::size_t>(mesh->GetNumberOfCells()));
  vtkNew<vtkIdList> corners;
  for (vtkIdType c = 0; c < mesh->GetNumberOfCells(); ++c) {
    mesh->GetCellPoints(c, corners);
    Vec3 sum = Vec3::Zero();
    for (vtkIdType i = 0; i < corners->GetNumberOfIds(); ++i) {
      Vec3 p;
      mesh->GetPoint(corners->GetId(i), p.data());
      sum += p;
    }
    centres[static_cast<std::size_t>(c)] =
        sum / static_cast<double>(std::max<vtkIdType>(corners->GetNumberOfIds(), 1));
  }
  return centres;
}

/// Extrapolates the averages at a range of points. Each parallel task has its own object.
class BoundaryFit {
 public:
  BoundaryFit(vtkDataSet* mesh, const std::vector<Vec3>& centres)
      : mesh_(mesh), centres_(centres) {}

  void moveAt(vtkIdType point, const std::vector<Moved>& arrays) {
    const Cells own = cellsAt(point);
    if (own.empty()) return;
    Vec3 p;
    mesh_->GetPoint(point, p.data());
    Vec3 mean = Vec3::Zero();
    for (const vtkIdType c : own) mean += centre(c);
    mean /= static_cast<double>(own.size());
    if (!isOneSided(own, p, mean)) return;
    const Cells around = grown(grown(own));
    const Eigen::VectorXd weights = weightsOf(around, p, mean);
    for (const Moved& array : arrays) move(array, point, around, weights);
  }

 private:
  [[nodiscard]] const Vec3& centre(vtkIdType cell) const {
    return centres_[static_cast<std::size_t>(cell)];
  }
  [[nodiscard]] Cells cellsAt(vtkIdType point) {
    mesh_->GetPointCells(point, cells_);
    return {cells_->begin(), cells_->end()};
  }
  /// Returns `cells` and all cells that share a point with them, in ascending order.
  [[nodiscard]] Cells grown(const Cells& cells) {
    Cells points;
    for (const vtkIdType c : cells) {
      mesh_->GetCellPoints(c, corners_);
      points.insert(points.end(), corners_->begin(), corners_->end());
    }
    makeUnique(points);
    Cells out;
    for (const vtkIdType p : points) {
      mesh_->GetPointCells(p, cells_);
      out.insert(out.end(), cells_->begin(), cells_->end());
    }
    makeUnique(out);
    return out;
  }
  static void makeUnique(Cells& ids) {
    std::sort(ids.begin(), ids.end());
    ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
  }

  /// Returns true if nearly all cells at p have their centres on one side of p, along the line from
  /// p to the mean of the centres, `mean`.
  [[nodiscard]] bool isOneSided(const Cells& own, const Vec3& p, const Vec3& mean) const {
    constexpr double kShare = 0.8;  // the ratio is 0 between equal cells, 1 at a plane boundary
    const Vec3 way = mean - p;
    double apart = 0.0;
    for (const vtkIdType c : own) apart += std::abs(way.dot(centre(c) - p));
    return way.squaredNorm() > kShare * apart / static_cast<double>(own.size());
  }

  /// Returns the weight of each cell's value in the difference between p and `mean`.
  [[nodiscard]] Eigen::VectorXd weightsOf(const Cells& cells, const Vec3& p,
                                          const Vec3& mean) const {
    constexpr double kFlat = 1e-12;  // relative variance below which centres are in one plane
    // Scales the positions to variance 1 along their main axes, because cells at walls are flat.
    Mat3 spread = Mat3::Zero();
    for (const vtkIdType c : cells) spread += (centre(c) - mean) * (centre(c) - mean).transpose();
    const Eigen::SelfAdjointEigenSolver<Mat3> axes(spread / static_cast<double>(cells.size()));
    Mat3 scaled = axes.eigenvectors().transpose();
    for (Eigen::Index a = 0; a < 3; ++a) {
      const double variance = axes.eigenvalues()[a];
      scaled.row(a) *= variance > kFlat * axes.eigenvalues()[2] ? 1.0 / std::sqrt(variance) : 0.0;
    }
    const auto terms = [&](const Vec3& at) {
      const Vec3 t = scaled * (at - mean);
      Eigen::Matrix<double, 10, 1> out;
      out << 1.0, t, t.cwiseAbs2(), t.x() * t.y(), t.x() * t.z(), t.y() * t.z();
      return out;
    };
    Eigen::MatrixXd fit(10, static_cast<Eigen::Index>(cells.size()));
    for (std::size_t i = 0; i < cells.size(); ++i) {
      fit.col(static_cast<Eigen::Index>(i)) = terms(centre(cells[i]));
    }
    const Eigen::VectorXd asked = terms(p) - terms(mean);
    Eigen::CompleteOrthogonalDecomposition<Eigen::MatrixXd> solver;
    solver.setThreshold(1e-6);
    solver.compute(fit);
    if (solver.rank() == 10) return solver.solve(asked);
    solver.compute(fit.topRows(4));
    return solver.solve(asked.head(4));
  }

  static void move(const Moved& array, vtkIdType point, const Cells& around,
                   const Eigen::VectorXd& weights) {
    for (int c = 0; c < array.cells->GetNumberOfComponents(); ++c) {
      double sum = 0.0;
      double low = std::numeric_limits<double>::infinity();
      double high = -low;
      bool finite = true;
      for (std::size_t i = 0; i < around.size(); ++i) {
        const double value = array.cells->GetComponent(around[i], c);
        finite = finite && std::isfinite(value);
        sum += weights[static_cast<Eigen::Index>(i)] * value;
        low = std::min(low, value);
        high = std::max(high, value);
      }
      if (!finite) return;
      const double moved =
          array.points->GetComponent(point, c) + std::clamp(sum, low - high, high - low);
      array.points->SetComponent(point, c, std::clamp(moved, array.lowest, array.highest));
    }
  }

  vtkDataSet* mesh_;
  const std::vector<Vec3>& centres_;
  vtkNew<vtkIdList> cells_;
  vtkNew<vtkIdList> corners_;
};

}  // namespace

void extrapolateToBoundary(vtkDataSet* mesh, const std::vector<std::string>& names) {
  const std::vector<Moved> arrays = movedOf(mesh, names);
  if (arrays.empty()) return;
  const std::vector<Vec3> centres = centresOf(mesh);
  mesh->GetPointCells(0, vtkNew<vtkIdList>());  // builds VTK's table before the threads read it
  tbb::parallel_for(tbb::blocked_range<vtkIdType>(0, mesh->GetNumberOfPoints(), 256),
                    [&](const tbb::blocked_range<vtkIdType>& part) {
                      BoundaryFit fit(mesh, centres);
                      for (vtkIdType p = part.begin(); p < part.end(); ++p) fit.moveAt(p, arrays);
                    });
}

}  // namespace palpate::importer
