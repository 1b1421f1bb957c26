#include "palpate/scenes/apps/import/displacement.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <mutex>
#include <utility>

#include <Eigen/LU>
#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/make_volume.h"
#include "palpate/samplers/parallel.h"
#include "palpate/samplers/time/warp_grid.h"
#include "palpate/scenes/apps/import/length_units.h"
#include "palpate/scenes/apps/import/shared_progress.h"

namespace palpate::importer {
namespace {

/// Largest residual of Newton's iteration at a voxel, as a share of the shortest voxel edge.
constexpr double kConverged = 1e-3;
/// Largest distance beyond a face at which a place still counts as within the field [voxels]. This
/// distance exceeds the rounding of float vectors and the residual at which the iteration ends.
constexpr double kOnFace = 1e-4;

/// Returns the length of a unit [m]; 1e-3 for unknown units and "".
double metresOf(const std::string& unit) {
  const LengthUnit* known = lengthUnitOf(unit);
  return known == nullptr ? 1e-3 : known->metres;
}

/// Residuals of an inverse at some places [m].
struct Residuals {
  double squares = 0.0;
  double largest = 0.0;
  std::size_t count = 0;
  std::size_t beyond = 0;  ///< Places whose u depends on the given field beyond its faces.

  void add(double residual) {
    squares += residual * residual;
    largest = std::max(largest, residual);
    ++count;
  }
  void add(const Residuals& more) {
    squares += more.squares;
    largest = std::max(largest, more.largest);
    count += more.count;
    beyond += more.beyond;
  }
};

class Inversion {
 public:
  Inversion(const DisplacementFrames& given, std::string file)
      : lattice_(given),
        given_(makeWarp(given, {}, file)),
        index_from_world_(given.axes.inverse()),
        edge_(given.axes.colwise().norm().minCoeff()),
        file_(std::move(file)) {}

  /// Returns the inverse at the nodes of the lattice.
  [[nodiscard]] DisplacementFrames invert(const Progress& progress) const {
    DisplacementFrames out = lattice_;
    const std::array<int, 3> size = lattice_.size;
    SharedProgress shared(progress, size[0]);
    inParallel(static_cast<std::size_t>(size[0]), [&](std::size_t i) {
      float* to = out.frames[0].data() +
                  3 * i * static_cast<std::size_t>(size[1]) * static_cast<std::size_t>(size[2]);
      Vec3 u = Vec3::Zero();
      for (int j = 0; j < size[1]; ++j) {
        for (int k = 0; k < size[2]; ++k, to += 3) {
          u = solve(placeOf(Vec3(static_cast<double>(i), j, k)), u);
          for (int c = 0; c < 3; ++c) to[c] = static_cast<float>(u[c]);
        }
      }
      shared.step();
    });
    return out;
  }

  /// Returns the residuals of an inverse at the nodes, or at the middles of the cells.
  [[nodiscard]] Residuals residualsOf(const Warp& inverse, bool middles) const {
    const double shift = middles ? 0.5 : 0.0;
    const int less = middles ? 1 : 0;
    Residuals all;
    std::mutex mutex;
    inParallel(static_cast<std::size_t>(lattice_.size[0] - less), [&](std::size_t i) {
      Residuals here;
      for (int j = 0; j < lattice_.size[1] - less; ++j) {
        for (int k = 0; k < lattice_.size[2] - less; ++k) {
          const Vec3 y = placeOf(Vec3(static_cast<double>(i) + shift, j + shift, k + shift));
          const Vec3 u = inverse.at(y, 0.0).shift;
          if (isWithin(y + u)) {
            here.add((u + given_->at(y + u, 0.0).shift).norm());
          } else {
            ++here.beyond;
          }
        }
      }
      const std::lock_guard lock(mutex);
      all.add(here);
    });
    return all;
  }

 private:
  [[nodiscard]] Vec3 placeOf(const Vec3& index) const {
    return lattice_.origin + lattice_.axes * index;
  }

  /// Returns true if a place is within the field, or at most kOnFace beyond a face.
  [[nodiscard]] bool isWithin(const Vec3& x) const {
    const Vec3 index = index_from_world_ * (x - lattice_.origin);
    for (int a = 0; a < 3; ++a) {
      const double last = lattice_.size[static_cast<std::size_t>(a)] - 1;
      if (!(index[a] >= -kOnFace && index[a] <= last + kOnFace)) return false;
    }
    return true;
  }

  /// Solves u + v(y + u) = 0 by Newton's iteration. A step is halved until it reduces the residual.
  [[nodiscard]] Vec3 solve(const Vec3& y, Vec3 u) const {
    constexpr int kMostSteps = 50;
    constexpr double kEnough = 1e-6;
    constexpr double kShortest = 1e-3;
    Displacement v = given_->at(y + u, 0.0);
    Vec3 residual = u + v.shift;
    for (int n = 0; n < kMostSteps && residual.norm() > kEnough * edge_; ++n) {
      const Vec3 step = (Mat3::Identity() + v.slope).inverse() * residual;
      double part = 1.0;
      for (; part > kShortest; part *= 0.5) {
        const Vec3 next = u - part * step;
        const Displacement at_next = given_->at(y + next, 0.0);
        if (!((next + at_next.shift).norm() < residual.norm())) continue;
        u = next;
        v = at_next;
        residual = u + v.shift;
        break;
      }
      if (!(part > kShortest)) break;
    }
    if (residual.norm() <= kConverged * edge_) return u;
    throw VolumeError(
        file_,
        fmt::format("the import finds no inverse at ({:.3g}, {:.3g}, {:.3g}) m: the residual is "
                    "{:.2g} voxels, more than {:g}",
                    y.x(), y.y(), y.z(), residual.norm() / edge_, kConverged),
        "smooth the field, or smooth it more, with --smooth, or export the transform from the "
        "fixed to the moving image");
  }

  DisplacementFrames lattice_;  ///< The given field.
  WarpPtr given_;
  Mat3 index_from_world_;
  double edge_;  ///< Shortest edge of a voxel [m].
  std::string file_;
};

/// Replaces the vectors of the grid by those of the lattice, which has the grid's active voxels.
void write(const DisplacementFrames& from, double metres, Gridded& made) {
  auto& grid = *openvdb::gridPtrCast<openvdb::Vec3SGrid>(made.grid);
  const openvdb::CoordBBox box = grid.evalActiveVoxelBoundingBox();
  auto accessor = grid.getAccessor();
  const float* u = from.frames[0].data();
  made.lowest = INFINITY;
  made.highest = 0.0;
  for (auto at = box.begin(); at; ++at, u += 3) {
    const openvdb::Vec3d vector = openvdb::Vec3d(u[0], u[1], u[2]) / metres;
    accessor.setValue(*at, openvdb::Vec3f(vector));
    made.lowest = std::min(made.lowest, vector.length());
    made.highest = std::max(made.highest, vector.length());
  }
}

}  // namespace

void takeDisplacement(Gridded& made, Direction direction, const std::string& length_unit,
                      const std::string& file, const Progress& progress,
                      std::vector<std::string>& notes) {
  if (made.holes > 0) {
    throw VolumeError(file,
                      fmt::format("{} voxels of the displacement field have no data", made.holes),
                      "export the field with a displacement at each voxel");
  }
  made.grid->setName("displacement");
  made.grid->setVectorType(openvdb::VEC_CONTRAVARIANT_RELATIVE);
  made.grid->setIsInWorldSpace(true);
  made.tolerance = 0.0;
  made.quieter_tolerance = 0.0;
  const double metres = metresOf(length_unit);
  Placement placement;
  placement.scale = metres;
  const std::array volumes{makeVolume(*made.grid)};
  const DisplacementFrames given = displacementsOf(volumes, placement, file);
  if (direction == Direction::kBackward) {
    (void)makeWarp(given, {}, file);
    notes.emplace_back(
        "the displacements are read as backward: from the fixed image (the present shape) to the "
        "moving image (the shape at rest)");
    return;
  }
  // write() needs a vector at each voxel of the box. A resampled field that is rotated has none at
  // its corners.
  const openvdb::CoordBBox box = made.grid->evalActiveVoxelBoundingBox();
  if (made.grid->activeVoxelCount() != box.volume()) {
    throw VolumeError(file, "after --voxel, parts of the field's box have no displacement",
                      "omit --voxel, or export the transform from the fixed to the moving image");
  }
  const Inversion inversion(given, file);
  const DisplacementFrames inverse = inversion.invert(progress);
  const WarpPtr warp = makeWarp(inverse, {}, file);
  Residuals found = inversion.residualsOf(*warp, /*middles=*/false);
  const std::size_t beyond = found.beyond;
  const std::size_t voxels = found.count + beyond;
  found.add(inversion.residualsOf(*warp, /*middles=*/true));
  const std::string unit = length_unit.empty() ? "mm" : length_unit;
  const double rms =
      std::sqrt(found.squares / static_cast<double>(std::max<std::size_t>(found.count, 1)));
  notes.push_back(
      fmt::format("the forward displacements are inverted: at the voxels and between them the "
                  "residual is {:.2g} {} rms, {:.2g} {} at most",
                  rms / metres, unit, found.largest / metres, unit));
  if (beyond > 0) {
    notes.push_back(
        fmt::format("the resting place of {:.2g} % of the voxels is outside the field: they use "
                    "the displacement "
                    "at the nearest point of the field's faces, and do not count in the residual",
                    100.0 * static_cast<double>(beyond) / static_cast<double>(voxels)));
  }
  write(inverse, metres, made);
}

}  // namespace palpate::importer
