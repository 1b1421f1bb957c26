#include "samplers/vdb_field.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <new>

#include <openvdb/openvdb.h>
#include <openvdb/tree/ValueAccessor.h>

#include "engine/error.h"
#include "samplers/spline.h"
#include "samplers/volume_grid.h"

namespace palpate {
namespace {

using openvdb::Coord;

/// A 4 x 4 x 4 block of voxels around a cell: index (i, j, k) is [16 i + 4 j + k], the cell's own
/// corners are 1 and 2 along each axis.
template <class T>
struct Block {
  std::array<T, 64> values;
  int active_corners = 0;  ///< Of the cell's eight.

  static constexpr int at(int i, int j, int k) noexcept { return 16 * i + 4 * j + k; }
};

/// Copies the block whose lowest corner is `low`, leaf by leaf: at most eight look-ups.
template <class Accessor, class T>
void copyBlock(const Accessor& accessor, const Coord& low, Block<T>& block) noexcept {
  const auto corner = [](int i) { return i == 1 || i == 2; };
  block.active_corners = 0;
  // Along each axis the block lies in one leaf or two: [0, split) and [split, 4).
  std::array<int, 3> split{};
  for (int a = 0; a < 3; ++a) {
    split[static_cast<std::size_t>(a)] = std::min(4, 8 - (low[a] & 7));
  }
  for (int i0 = 0; i0 < 4; i0 = i0 < split[0] ? split[0] : 4) {
    const int i1 = i0 < split[0] ? split[0] : 4;
    for (int j0 = 0; j0 < 4; j0 = j0 < split[1] ? split[1] : 4) {
      const int j1 = j0 < split[1] ? split[1] : 4;
      for (int k0 = 0; k0 < 4; k0 = k0 < split[2] ? split[2] : 4) {
        const int k1 = k0 < split[2] ? split[2] : 4;
        const Coord first = low.offsetBy(i0, j0, k0);
        const auto* leaf = accessor.probeConstLeaf(first);
        const bool tile_on = leaf == nullptr && accessor.isValueOn(first);
        const T tile = leaf == nullptr ? accessor.getValue(first) : openvdb::zeroVal<T>();
        const T* data = leaf == nullptr ? nullptr : leaf->buffer().data();
        for (int i = i0; i < i1; ++i) {
          for (int j = j0; j < j1; ++j) {
            for (int k = k0; k < k1; ++k) {
              const auto offset = static_cast<openvdb::Index>(
                  (((low[0] + i) & 7) << 6) | (((low[1] + j) & 7) << 3) | ((low[2] + k) & 7));
              block.values[static_cast<std::size_t>(Block<T>::at(i, j, k))] =
                  data == nullptr ? tile : data[offset];
              if (corner(i) && corner(j) && corner(k)) {
                block.active_corners += (leaf == nullptr ? tile_on : leaf->isValueOn(offset));
              }
            }
          }
        }
      }
    }
  }
}

/// N numbers at a cell's corners, corner (i, j, k) at [4 i + 2 j + k], as coefficients of the
/// trilinear polynomial c0 + c1 u + c2 v + c3 w + c4 uv + c5 uw + c6 vw + c7 uvw.
template <int N>
struct Trilinear {
  using Row = Eigen::Array<double, N, 1>;
  std::array<Row, 8> c;

  void fit(const std::array<Row, 8>& d) noexcept {
    c[0] = d[0];
    c[1] = d[4] - d[0];
    c[2] = d[2] - d[0];
    c[3] = d[1] - d[0];
    c[4] = (d[6] - d[2]) - c[1];
    c[5] = (d[5] - d[1]) - c[1];
    c[6] = (d[3] - d[1]) - c[2];
    c[7] = (d[7] - d[3]) - (d[5] - d[1]) - c[4];
  }

  [[nodiscard]] Row operator()(const Vec3& t) const noexcept {
    const Row uv = c[4] + c[7] * t.z();
    const Row u = c[1] + c[5] * t.z();
    const Row v = c[2] + c[6] * t.z();
    return c[0] + c[3] * t.z() + v * t.y() + (u + uv * t.y()) * t.x();
  }

  /// Gradient of row `n`'s polynomial.
  [[nodiscard]] Vec3 slope(const Vec3& t, Eigen::Index n) const noexcept {
    const double uv = c[4][n] + c[7][n] * t.z();
    return {c[1][n] + c[5][n] * t.z() + uv * t.y(), c[2][n] + c[6][n] * t.z() + uv * t.x(),
            c[3][n] + c[5][n] * t.x() + (c[6][n] + c[7][n] * t.x()) * t.y()};
  }
};

constexpr int kNoCell = std::numeric_limits<int>::max();

/// What a reader keeps of a grid: the accessor and the last cell.
template <class GridT, int N>
struct CellCache {
  using Accessor = openvdb::tree::ValueAccessor<const typename GridT::TreeType, false>;
  Accessor accessor;
  std::array<int, 3> cell{kNoCell, kNoCell, kNoCell};
  bool inside = false;
  Trilinear<N> poly;

  explicit CellCache(const GridT& grid) : accessor(grid.tree()) {}
};

/// The map between W and a grid's index space, and what follows from it.
struct IndexMap {
  Mat3 index_from_world;  ///< p_I = index_from_world p_W + origin_I
  Vec3 origin_I;
  Mat3 gradient_from_index;  ///< g_W = gradient_from_index g_I, per unit of the file
  Mat3 rotation;             ///< file to W

  IndexMap(const Volume::Grid& grid, const Placement& placement) {
    const Mat3 index_from_file = grid.linear.inverse();
    index_from_world = index_from_file * placement.rotation.transpose() / placement.scale;
    origin_I = -index_from_world * placement.translate - index_from_file * grid.origin;
    gradient_from_index = placement.rotation * index_from_file.transpose();
    rotation = placement.rotation;
  }
};

/// Splits p_I into cell and position in it; false where it is no place in a grid.
bool locate(const Vec3& p_I, std::array<int, 3>& cell, Vec3& t) noexcept {
  if (!(p_I.cwiseAbs().maxCoeff() < 1e9)) return false;  // false for NaN as well
  for (int a = 0; a < 3; ++a) {
    const double floor = std::floor(p_I[a]);
    cell[static_cast<std::size_t>(a)] = static_cast<int>(floor);
    t[a] = p_I[a] - floor;
  }
  return !p_I.hasNaN();
}

Vec3 asVec3(const openvdb::Vec3d& v) noexcept {
  return {v.x(), v.y(), v.z()};
}

FieldFrame frameOf(const Volume& volume, const Placement& placement) {
  // As far beyond the active voxels' centres as a cell with an active corner reaches.
  const Vec3 margin = volume.grid().linear.cwiseAbs().rowwise().sum();
  const Box& file = volume.info().bounds;
  FieldFrame frame;
  frame.voxel = volume.info().voxel.minCoeff() * placement.scale;
  frame.metres_per_unit = placement.scale;
  for (int corner = 0; corner < 8; ++corner) {
    Vec3 p_F;
    for (int a = 0; a < 3; ++a) {
      const bool upper = ((corner >> a) & 1) != 0;
      p_F[a] = upper ? file.upper[a] + margin[a] : file.lower[a] - margin[a];
    }
    frame.bounds.extend(placement(p_F));
  }
  return frame;
}

/// What scalar and vector fields share: the grid, its map, and the cell that a position is in. Rows
/// of a cell: the C components of the value, then their central differences, index axis by axis.
template <class GridT, int C>
class CellReader {
  using Value = typename GridT::ValueType;
  using Cache = CellCache<GridT, 4 * C>;
  using Row = Eigen::Array<double, 4 * C, 1>;
  static_assert(sizeof(Cache) <= sizeof(FieldCache::bytes));

 public:
  CellReader(std::shared_ptr<const Volume> volume, typename GridT::ConstPtr grid,
             const Placement& placement)
      : volume_(std::move(volume)),
        grid_(std::move(grid)),
        map_(volume_->grid(), placement),
        // For `inside`: a level set means something only within its band.
        corners_needed_(volume_->info().grid_class == GridClass::kLevelSet ? 8 : 1) {}

  void reset(FieldCache& memory) const noexcept { ::new (memory.bytes.data()) Cache(*grid_); }

  /// The cell at p_W, and the position t in it; null where there is no place in the grid.
  const Cache* find(const Vec3& p_W, FieldCache& memory, Vec3& t) const noexcept {
    auto& cache = *std::launder(reinterpret_cast<Cache*>(memory.bytes.data()));
    std::array<int, 3> cell{};
    if (!locate(map_.index_from_world * p_W + map_.origin_I, cell, t)) return nullptr;
    if (cell != cache.cell) load(cell, cache);
    return &cache;
  }

  [[nodiscard]] const GridT& grid() const noexcept { return *grid_; }
  [[nodiscard]] const IndexMap& map() const noexcept { return map_; }

 private:
  void load(const std::array<int, 3>& cell, Cache& cache) const noexcept {
    Block<Value> block;
    copyBlock(cache.accessor, Coord(cell[0] - 1, cell[1] - 1, cell[2] - 1), block);
    std::array<Row, 8> corners;
    for (int n = 0; n < 8; ++n) {
      const std::ptrdiff_t at = Block<Value>::at(1 + (n >> 2), 1 + ((n >> 1) & 1), 1 + (n & 1));
      const auto v = [&](std::ptrdiff_t offset, int c) {
        return component(block.values[static_cast<std::size_t>(at + offset)], c);
      };
      Row& row = corners[static_cast<std::size_t>(n)];
      for (int c = 0; c < C; ++c) {
        row[c] = v(0, c);
        row[C + c] = 0.5 * (v(16, c) - v(-16, c));
        row[2 * C + c] = 0.5 * (v(4, c) - v(-4, c));
        row[3 * C + c] = 0.5 * (v(1, c) - v(-1, c));
      }
    }
    cache.poly.fit(corners);
    cache.inside = block.active_corners >= corners_needed_;
    cache.cell = cell;
  }

  static double component(const Value& value, int c) noexcept {
    if constexpr (C == 1) {
      return static_cast<double>(value);
    } else {
      return static_cast<double>(value[c]);
    }
  }

  std::shared_ptr<const Volume> volume_;
  typename GridT::ConstPtr grid_;
  IndexMap map_;
  int corners_needed_;
};

template <class GridT>
class VdbScalarField final : public ScalarField {
 public:
  VdbScalarField(const std::shared_ptr<const Volume>& volume, const typename GridT::ConstPtr& grid,
                 const Placement& placement)
      : ScalarField(frameOf(*volume, placement)), reader_(volume, grid, placement) {}

  void reset(FieldCache& cache) const noexcept override { reader_.reset(cache); }

  [[nodiscard]] ScalarSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    Vec3 t;
    ScalarSample out;
    const auto* cell = reader_.find(p_W, memory, t);
    if (cell == nullptr) {
      out.value = static_cast<double>(reader_.grid().background());
      return out;
    }
    const Eigen::Array4d row = cell->poly(t);
    out.value = row[0];
    out.gradient = reader_.map().gradient_from_index * Vec3(row[1], row[2], row[3]);
    out.cell_gradient = reader_.map().gradient_from_index * cell->poly.slope(t, 0);
    out.inside = cell->inside;
    return out;
  }

 private:
  CellReader<GridT, 1> reader_;
};

template <class GridT>
class VdbVectorField final : public VectorField {
 public:
  VdbVectorField(const std::shared_ptr<const Volume>& volume, const typename GridT::ConstPtr& grid,
                 const Placement& placement)
      : VectorField(frameOf(*volume, placement)), reader_(volume, grid, placement) {}

  void reset(FieldCache& cache) const noexcept override { reader_.reset(cache); }

  [[nodiscard]] VectorSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    Vec3 t;
    VectorSample out;
    const IndexMap& map = reader_.map();
    const auto* cell = reader_.find(p_W, memory, t);
    if (cell == nullptr) {
      out.value = map.rotation * asVec3(openvdb::Vec3d(reader_.grid().background()));
      return out;
    }
    const Eigen::Array<double, 12, 1> row = cell->poly(t);
    out.value = map.rotation * row.head<3>().matrix();
    // d v_F / d index, columns are axes; then both indices into W.
    Mat3 J;
    J << row[3], row[6], row[9], row[4], row[7], row[10], row[5], row[8], row[11];
    out.jacobian = map.rotation * J * map.gradient_from_index.transpose();
    out.inside = cell->inside;
    return out;
  }

 private:
  CellReader<GridT, 3> reader_;
};

/// Weights of the 4 x 4 x 4 block about a cell, along one axis, and their derivatives by the index.
struct Weights {
  std::array<double, 4> w{};
  std::array<double, 4> slope{};

  Weights(Interpolation interpolation, double t) noexcept {
    // The nearest voxel: the cell's lower corner or its upper one.
    const std::size_t upper = t < 0.5 ? 0 : 1;
    const double u = t - static_cast<double>(upper);
    switch (interpolation) {
      case Interpolation::kNearest:
      case Interpolation::kTrilinear:
        w[1 + upper] = 1.0;
        break;
      case Interpolation::kQuadratic:
        w[upper] = 0.5 * (0.5 - u) * (0.5 - u);
        w[upper + 1] = 0.75 - u * u;
        w[upper + 2] = 0.5 * (0.5 + u) * (0.5 + u);
        slope[upper] = u - 0.5;
        slope[upper + 1] = -2.0 * u;
        slope[upper + 2] = u + 0.5;
        break;
      case Interpolation::kCubic: {
        const double r = 1.0 - t;
        w = {r * r * r / 6.0, (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
             (4.0 - 6.0 * r * r + 3.0 * r * r * r) / 6.0, t * t * t / 6.0};
        slope = {-0.5 * r * r, t * (1.5 * t - 2.0), -r * (1.5 * r - 2.0), 0.5 * t * t};
        break;
      }
    }
  }
};

/// As CellReader, for B-splines and the nearest voxel: the block about the cell is kept, and
/// weighed anew for each position.
template <class GridT, int C>
class BlockReader {
  using Value = typename GridT::ValueType;
  using Row = Eigen::Array<double, C, 1>;
  struct Cache {
    openvdb::tree::ValueAccessor<const typename GridT::TreeType, false> accessor;
    std::array<int, 3> cell{kNoCell, kNoCell, kNoCell};
    Block<Value> block;

    explicit Cache(const GridT& grid) : accessor(grid.tree()) {}
  };
  static_assert(sizeof(Cache) <= sizeof(FieldCache::bytes));

 public:
  /// Value and derivatives by the index.
  struct Answer {
    Row value = Row::Zero();
    std::array<Row, 3> slope{Row::Zero(), Row::Zero(), Row::Zero()};
    bool inside = false;
  };

  BlockReader(std::shared_ptr<const Volume> volume, const typename GridT::ConstPtr& grid,
              const Placement& placement, Interpolation interpolation)
      : volume_(std::move(volume)),
        grid_(grid),
        map_(volume_->grid(), placement),
        interpolation_(interpolation),
        corners_needed_(volume_->info().grid_class == GridClass::kLevelSet ? 8 : 1) {
    if (interpolation == Interpolation::kQuadratic) grid_ = splineCoefficients(*grid, 2);
    if (interpolation == Interpolation::kCubic) grid_ = splineCoefficients(*grid, 3);
  }

  void reset(FieldCache& memory) const noexcept { ::new (memory.bytes.data()) Cache(*grid_); }

  /// False where there is no place in the grid.
  bool read(const Vec3& p_W, FieldCache& memory, Answer& out) const noexcept {
    auto& cache = *std::launder(reinterpret_cast<Cache*>(memory.bytes.data()));
    std::array<int, 3> cell{};
    Vec3 t;
    if (!locate(map_.index_from_world * p_W + map_.origin_I, cell, t)) return false;
    if (cell != cache.cell) {
      copyBlock(cache.accessor, Coord(cell[0] - 1, cell[1] - 1, cell[2] - 1), cache.block);
      cache.cell = cell;
    }
    const Weights x(interpolation_, t.x());
    const Weights y(interpolation_, t.y());
    const Weights z(interpolation_, t.z());
    const auto at = [&](std::size_t i) {
      const Value& value = cache.block.values[i];
      if constexpr (C == 1) {
        return Row(static_cast<double>(value));
      } else {
        return Row(static_cast<double>(value[0]), static_cast<double>(value[1]),
                   static_cast<double>(value[2]));
      }
    };
    // Along z, then y, then x.
    for (std::size_t i = 0; i < 4; ++i) {
      Row plane = Row::Zero();
      Row plane_y = Row::Zero();
      Row plane_z = Row::Zero();
      for (std::size_t j = 0; j < 4; ++j) {
        Row line = Row::Zero();
        Row line_z = Row::Zero();
        for (std::size_t k = 0; k < 4; ++k) {
          const Row value = at(16 * i + 4 * j + k);
          line += z.w[k] * value;
          line_z += z.slope[k] * value;
        }
        plane += y.w[j] * line;
        plane_y += y.slope[j] * line;
        plane_z += y.w[j] * line_z;
      }
      out.value += x.w[i] * plane;
      out.slope[0] += x.slope[i] * plane;
      out.slope[1] += x.w[i] * plane_y;
      out.slope[2] += x.w[i] * plane_z;
    }
    out.inside = cache.block.active_corners >= corners_needed_;
    return true;
  }

  [[nodiscard]] const GridT& grid() const noexcept { return *grid_; }
  [[nodiscard]] const IndexMap& map() const noexcept { return map_; }

 private:
  std::shared_ptr<const Volume> volume_;
  typename GridT::ConstPtr grid_;
  IndexMap map_;
  Interpolation interpolation_;
  int corners_needed_;
};

template <class GridT>
class BlockScalarField final : public ScalarField {
 public:
  BlockScalarField(const std::shared_ptr<const Volume>& volume,
                   const typename GridT::ConstPtr& grid, const Placement& placement,
                   Interpolation interpolation)
      : ScalarField(frameOf(*volume, placement)), reader_(volume, grid, placement, interpolation) {}

  void reset(FieldCache& cache) const noexcept override { reader_.reset(cache); }

  [[nodiscard]] ScalarSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    typename BlockReader<GridT, 1>::Answer answer;
    ScalarSample out;
    if (!reader_.read(p_W, memory, answer)) {
      out.value = static_cast<double>(reader_.grid().background());
      return out;
    }
    out.value = answer.value[0];
    out.gradient = reader_.map().gradient_from_index *
                   Vec3(answer.slope[0][0], answer.slope[1][0], answer.slope[2][0]);
    out.cell_gradient = out.gradient;
    out.inside = answer.inside;
    return out;
  }

 private:
  BlockReader<GridT, 1> reader_;
};

template <class GridT>
class BlockVectorField final : public VectorField {
 public:
  BlockVectorField(const std::shared_ptr<const Volume>& volume,
                   const typename GridT::ConstPtr& grid, const Placement& placement,
                   Interpolation interpolation)
      : VectorField(frameOf(*volume, placement)), reader_(volume, grid, placement, interpolation) {}

  void reset(FieldCache& cache) const noexcept override { reader_.reset(cache); }

  [[nodiscard]] VectorSample sample(const Vec3& p_W, FieldCache& memory) const noexcept override {
    typename BlockReader<GridT, 3>::Answer answer;
    VectorSample out;
    const IndexMap& map = reader_.map();
    if (!reader_.read(p_W, memory, answer)) {
      out.value = map.rotation * asVec3(openvdb::Vec3d(reader_.grid().background()));
      return out;
    }
    out.value = map.rotation * answer.value.matrix();
    Mat3 J;
    J << answer.slope[0].matrix(), answer.slope[1].matrix(), answer.slope[2].matrix();
    out.jacobian = map.rotation * J * map.gradient_from_index.transpose();
    out.inside = answer.inside;
    return out;
  }

 private:
  BlockReader<GridT, 3> reader_;
};

}  // namespace

Placement fitInto(const Box& bounds_F, double size) {
  const double longest = bounds_F.size().maxCoeff();
  if (!(longest > 0.0) || !std::isfinite(longest)) {
    throw VolumeError("fit", "the volume is one voxel and has no extent", "give its scale instead");
  }
  Placement placement;
  placement.scale = size / longest;
  placement.translate = -placement.scale * bounds_F.centre();
  return placement;
}

FieldPtr makeVdbField(std::shared_ptr<const Volume> volume, const Placement& placement,
                      Interpolation interpolation) {
  const bool trilinear = interpolation == Interpolation::kTrilinear;
  return std::visit(
      [&](const auto& grid) -> FieldPtr {
        using GridT = std::remove_const_t<typename std::decay_t<decltype(grid)>::element_type>;
        if constexpr (std::is_arithmetic_v<typename GridT::ValueType>) {
          if (trilinear) {
            return std::make_shared<const VdbScalarField<GridT>>(volume, grid, placement);
          }
          return std::make_shared<const BlockScalarField<GridT>>(volume, grid, placement,
                                                                 interpolation);
        } else {
          if (trilinear) {
            return std::make_shared<const VdbVectorField<GridT>>(volume, grid, placement);
          }
          return std::make_shared<const BlockVectorField<GridT>>(volume, grid, placement,
                                                                 interpolation);
        }
      },
      volume->grid().data);
}

const char* wordFor(Interpolation interpolation) noexcept {
  switch (interpolation) {
    case Interpolation::kTrilinear:
      return "trilinear";
    case Interpolation::kNearest:
      return "nearest";
    case Interpolation::kQuadratic:
      return "quadratic";
    case Interpolation::kCubic:
      return "cubic";
  }
  return "";
}

std::optional<Interpolation> interpolationNamed(const std::string& word) noexcept {
  for (const Interpolation i : {Interpolation::kTrilinear, Interpolation::kNearest,
                                Interpolation::kQuadratic, Interpolation::kCubic}) {
    if (word == wordFor(i)) return i;
  }
  return std::nullopt;
}

}  // namespace palpate
