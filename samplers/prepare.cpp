#include "samplers/prepare.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <new>
#include <type_traits>
#include <utility>

#include <openvdb/tools/Filter.h>
#include <openvdb/tools/LevelSetFilter.h>
#include <openvdb/tools/VectorTransformer.h>
#include <openvdb/tree/LeafManager.h>
#include <openvdb/tree/NodeManager.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include "engine/error.h"

namespace palpate {
namespace {

using openvdb::Coord;
using Progress = std::function<void(double)>;

/// Finite, and small enough that no derivative or spline coefficient of it overflows.
template <class Real>
bool isUsable(Real v) noexcept {
  constexpr Real kMost = std::min<double>(1e100, std::numeric_limits<Real>::max());
  return std::abs(v) <= kMost;
}

/// The value of a scalar, the magnitude of a vector.
template <class T>
auto sizeOf(const T& value) noexcept {
  if constexpr (std::is_arithmetic_v<T>) {
    return value;
  } else {
    return openvdb::Vec3d(value).length();
  }
}

/// Lowest, highest and mean of a grid's active values; all stored values count for being usable.
struct Range {
  double sum = 0.0;
  double count = 0.0;
  double lowest = std::numeric_limits<double>::infinity();
  double highest = -std::numeric_limits<double>::infinity();
  std::uint64_t unusable = 0;

  void add(double v, bool active, double voxels = 1.0) noexcept {
    if (!isUsable(v)) {
      ++unusable;
    } else if (active) {
      sum += v * voxels;
      count += voxels;
      lowest = std::min(lowest, v);
      highest = std::max(highest, v);
    }
  }
  void join(const Range& other) noexcept {
    sum += other.sum;
    count += other.count;
    lowest = std::min(lowest, other.lowest);
    highest = std::max(highest, other.highest);
    unusable += other.unusable;
  }
  /// A leaf's voxels, eight at a time as its mask has them: a few times faster than one by one.
  template <class Leaf>
  void addLeaf(const Leaf& leaf) noexcept {
    using Size = decltype(sizeOf(*leaf.buffer().data()));
    std::array<Size, 8> low;
    std::array<Size, 8> high;
    std::array<double, 8> total{};
    low.fill(std::numeric_limits<Size>::infinity());
    high.fill(-std::numeric_limits<Size>::infinity());
    const auto* data = leaf.buffer().data();
    for (openvdb::Index row = 0; row < Leaf::SIZE; row += 8) {
      const auto bits = leaf.valueMask().template getWord<std::uint8_t>(row / 8);
      std::array<Size, 8> v;
      int bad = 0;
      for (std::size_t z = 0; z < 8; ++z) v[z] = sizeOf(data[row + z]);
      for (std::size_t z = 0; z < 8; ++z) bad += static_cast<int>(!isUsable(v[z]));
      if (bad == 0 && bits == 0xFF) {
        for (std::size_t z = 0; z < 8; ++z) {
          low[z] = v[z] < low[z] ? v[z] : low[z];
          high[z] = v[z] > high[z] ? v[z] : high[z];
          total[z] += static_cast<double>(v[z]);
        }
        count += 8.0;
      } else if (bad != 0 || bits != 0) {
        for (std::size_t z = 0; z < 8; ++z) {
          add(static_cast<double>(v[z]), ((bits >> z) & 1) != 0);
        }
      }
    }
    for (std::size_t z = 0; z < 8; ++z) {
      sum += total[z];
      lowest = std::min(lowest, static_cast<double>(low[z]));
      highest = std::max(highest, static_cast<double>(high[z]));
    }
  }
};

/// Reads a leaf that is still on disk.
template <class Leaf>
void readLeaf(Leaf& leaf) {
  using Buffer = typename Leaf::Buffer;
  using Value = typename Leaf::ValueType;
  static_assert(OPENVDB_LIBRARY_MAJOR_VERSION_NUMBER == 10, "see whether this is still so");
  try {
    (void)leaf.buffer().data();
  } catch (...) {
    // OpenVDB 10 leaves a buffer that could not be read in a state that its destructor takes for
    // another: its memory, the first member, is given back here, and a sound buffer put in place.
    delete[] * reinterpret_cast<Value**>(&leaf.buffer());
    ::new (static_cast<void*>(&leaf.buffer())) Buffer(openvdb::zeroVal<Value>());
    throw;
  }
}

/// The tiles of the nodes above the leaves.
struct TileRange {
  Range range;

  TileRange() = default;
  TileRange(const TileRange& /*whole*/, tbb::split /*tag*/) {}
  template <class Node>
  bool operator()(const Node& node) {
    for (auto tile = node.cbeginValueAll(); tile; ++tile) {
      range.add(static_cast<double>(sizeOf(*tile)), tile.isValueOn(),
                static_cast<double>(Node::ChildNodeType::NUM_VOXELS));
    }
    return true;
  }
  void join(const TileRange& other) noexcept { range.join(other.range); }
};

/// Looks at every value, and thereby reads the leaves that are still on disk.
template <class GridT>
Range rangeOf(GridT& grid, const Progress& progress = nullptr) {
  using Tree = typename GridT::TreeType;
  openvdb::tree::LeafManager<Tree> leaves(grid.tree());
  // In parts, so that somebody can be told how far it is.
  const std::size_t parts = progress && leaves.leafCount() > 10000 ? 16 : 1;
  Range range;
  for (std::size_t part = 0; part < parts; ++part) {
    const tbb::blocked_range<std::size_t> here(leaves.leafCount() * part / parts,
                                               leaves.leafCount() * (part + 1) / parts, 64);
    range.join(tbb::parallel_deterministic_reduce(
        here, Range{},
        [&](const tbb::blocked_range<std::size_t>& some, Range sum) {
          for (std::size_t i = some.begin(); i < some.end(); ++i) {
            readLeaf(leaves.leaf(i));
            sum.addLeaf(leaves.leaf(i));
          }
          return sum;
        },
        [](Range a, const Range& b) {
          a.join(b);
          return a;
        }));
    if (progress) progress(static_cast<double>(part + 1) / static_cast<double>(parts));
  }
  // Nodes above the leaves.
  TileRange tiles;
  openvdb::tree::NodeManager<const Tree, Tree::RootNodeType::LEVEL - 1>(grid.constTree())
      .reduceTopDown(tiles);
  range.join(tiles.range);
  range.add(sizeOf(grid.background()), false);
  return range;
}

/// Makes what is no number the background, inactive; a background that is none becomes zero.
template <class GridT>
void fillUnusable(GridT& grid) {
  using Value = typename GridT::ValueType;
  using Tree = typename GridT::TreeType;
  if (!isUsable(sizeOf(grid.background()))) {
    grid.tree().root().setBackground(openvdb::zeroVal<Value>(), /*updateChildNodes=*/false);
  }
  const Value background = grid.background();
  openvdb::tree::LeafManager<Tree> leaves(grid.tree());
  leaves.foreach ([&](typename Tree::LeafNodeType& leaf, std::size_t) {
    for (openvdb::Index i = 0; i < Tree::LeafNodeType::SIZE; ++i) {
      if (!isUsable(sizeOf(leaf.getValue(i)))) leaf.setValueOff(i, background);
    }
  });
  auto tile = grid.beginValueAll();
  tile.setMaxDepth(GridT::ValueAllIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) {
    if (isUsable(sizeOf(*tile))) continue;
    tile.setValue(background);
    tile.setValueOff();
  }
}

/// OpenVDB's Gaussian, and how far it moved the active values.
template <class GridT>
Smoothing smooth(GridT& grid, int width) {
  using Value = typename GridT::ValueType;
  using Tree = typename GridT::TreeType;
  const Tree before(grid.constTree());
  if constexpr (std::is_floating_point_v<Value>) {
    if (grid.getGridClass() == openvdb::GRID_LEVEL_SET) {
      openvdb::tools::LevelSetFilter<GridT>(grid).gaussian(width);
    } else {
      openvdb::tools::Filter<GridT>(grid).gaussian(width);
    }
  } else {
    openvdb::tools::Filter<GridT>(grid).gaussian(width);
  }
  Smoothing report;
  report.width = width;
  double squares = 0.0;
  double voxels = 0.0;
  openvdb::tree::ValueAccessor<const Tree, false> now(grid.constTree());
  for (auto leaf = before.cbeginLeaf(); leaf; ++leaf) {
    const auto* after = now.probeConstLeaf(leaf->origin());
    for (auto value = leaf->cbeginValueOn(); value; ++value) {
      const Value moved =
          after != nullptr ? after->getValue(value.pos()) : now.getValue(value.getCoord());
      const double change = std::abs(static_cast<double>(sizeOf(Value(moved - *value))));
      squares += change * change;
      voxels += 1.0;
      report.largest_change = std::max(report.largest_change, change);
    }
  }
  report.rms_change = voxels > 0.0 ? std::sqrt(squares / voxels) : 0.0;
  // Four box filters of 2 width + 1 voxels make a Gaussian of this variance; a wave of length l
  // keeps exp(-2 (pi sigma / l)^2) of its height.
  const double box = 2.0 * width + 1.0;
  const double sigma = std::sqrt(4.0 * (box * box - 1.0) / 12.0);
  report.half_height_voxels = sigma * M_PI * std::sqrt(2.0 / std::log(2.0));
  return report;
}

/// One component of a vector grid as a grid of its own.
template <class ScalarGrid, class VectorGrid>
typename ScalarGrid::Ptr componentGrid(const VectorGrid& grid, int c) {
  using ScalarTree = typename ScalarGrid::TreeType;
  using Leaf = typename ScalarTree::LeafNodeType;
  const auto& from = grid.constTree();
  auto tree = std::make_shared<ScalarTree>(from, grid.background()[c], openvdb::TopologyCopy());
  auto tile = tree->beginValueAll();
  tile.setMaxDepth(ScalarTree::ValueAllIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) tile.setValue(from.getValue(tile.getCoord())[c]);
  openvdb::tree::LeafManager<ScalarTree> leaves(*tree);
  leaves.foreach ([&](Leaf& leaf, std::size_t) {
    const auto* vectors = from.probeConstLeaf(leaf.origin());
    for (openvdb::Index i = 0; i < Leaf::SIZE; ++i) {
      leaf.setValueOnly(i, vectors->getValue(i)[c]);
    }
  });
  return ScalarGrid::create(tree);
}

Vec3 vec(const openvdb::Vec3d& v) {
  return {v.x(), v.y(), v.z()};
}

/// file = linear * index + origin; false where the map is not affine or is singular.
bool affineMap(const openvdb::GridBase& grid, Mat3& linear, Vec3& origin) {
  const openvdb::math::Transform& transform = grid.transform();
  if (!transform.isLinear()) return false;
  origin = vec(transform.indexToWorld(openvdb::Vec3d(0, 0, 0)));
  for (int i = 0; i < 3; ++i) {
    openvdb::Vec3d e(0, 0, 0);
    e[i] = 1.0;
    linear.col(i) = vec(transform.indexToWorld(e)) - origin;
  }
  const double size = linear.col(0).norm() * linear.col(1).norm() * linear.col(2).norm();
  return origin.allFinite() && linear.allFinite() && std::abs(linear.determinant()) > 1e-9 * size &&
         size > 0.0;
}

GridClass classOf(const openvdb::GridBase& grid) {
  switch (grid.getGridClass()) {
    case openvdb::GRID_LEVEL_SET:
      return GridClass::kLevelSet;
    case openvdb::GRID_FOG_VOLUME:
      return GridClass::kFog;
    case openvdb::GRID_STAGGERED:
      return GridClass::kStaggered;
    default:
      return GridClass::kUnknown;
  }
}

/// For a grid whose tree was not read: what its metadata say of it.
void takeStatistics(const openvdb::GridBase& grid, GridInfo& info, openvdb::CoordBBox& active) {
  using openvdb::GridBase;
  const auto voxels = grid.getMetadata<openvdb::Int64Metadata>(GridBase::META_FILE_VOXEL_COUNT);
  const auto memory = grid.getMetadata<openvdb::Int64Metadata>(GridBase::META_FILE_MEM_BYTES);
  const auto low = grid.getMetadata<openvdb::Vec3IMetadata>(GridBase::META_FILE_BBOX_MIN);
  const auto high = grid.getMetadata<openvdb::Vec3IMetadata>(GridBase::META_FILE_BBOX_MAX);
  if (voxels != nullptr && low != nullptr && high != nullptr) {
    info.active_voxels = static_cast<std::uint64_t>(std::max<std::int64_t>(0, voxels->value()));
    active = openvdb::CoordBBox(Coord(low->value()), Coord(high->value()));
  }
  if (memory != nullptr) {
    info.memory = static_cast<std::uint64_t>(std::max<std::int64_t>(0, memory->value()));
  }
}

/// Of the active voxels' centres, in the file's world space.
Box boundsOf(const openvdb::CoordBBox& active, const Volume::Grid::Part& part) {
  const auto vec3 = [](const Coord& c) { return Vec3(c.x(), c.y(), c.z()); };
  return boxAbout({vec3(active.min()), vec3(active.max())},
                  [&](const Vec3& p_I) { return part.toFile(p_I); });
}

/// From the grid's index space to the file's world space, each kind of vector by its own rule.
template <class GridT>
void turnVectors(GridT& grid) {
  const openvdb::Mat4d map = grid.transform().baseMap()->getAffineMap()->getMat4();
  grid.setIsInWorldSpace(true);  // else nothing is turned
  // OpenVDB leaves the background as it is.
  auto one = GridT::create();
  one->setVectorType(grid.getVectorType());
  one->tree().setValue(Coord(0, 0, 0), grid.background());
  openvdb::tools::transformVectors(*one, map);
  openvdb::tools::transformVectors(grid, map);
  grid.tree().root().setBackground(one->tree().getValue(Coord(0, 0, 0)),
                                   /*updateChildNodes=*/false);
}

/// The values of a grid of a type that can be felt: looked at, filled, smoothed, turned.
template <class GridT>
void prepareValues(GridT& grid, const LoadOptions& options, bool affine, GridInfo& info) {
  Range range = rangeOf(grid, options.progress);
  const auto fill = [&] {
    if (range.unusable == 0 || options.non_finite == NonFinite::kRefuse) return;
    info.filled += range.unusable;
    fillUnusable(grid);
    range = rangeOf(grid);
  };
  fill();
  if (options.smooth > 0 && range.unusable == 0) {
    try {
      info.smoothing = smooth(grid, options.smooth);
    } catch (const openvdb::Exception& e) {
      throw VolumeError("grid \"" + info.name + "\"",
                        "it cannot be smoothed (" + std::string(e.what()) + ")",
                        "remove \"smooth\"");
    }
    range = rangeOf(grid);
    fill();
  }
  if constexpr (!std::is_arithmetic_v<typename GridT::ValueType>) {
    info.vector = true;
    info.was_local = !grid.isInWorldSpace() && grid.getVectorType() != openvdb::VEC_INVARIANT;
    if (info.was_local && affine) {
      turnVectors(grid);
      range = rangeOf(grid);
      fill();
    }
  }
  info.non_finite = range.unusable;
  info.background = sizeOf(grid.background());
  if (range.lowest <= range.highest) {
    info.lowest = range.lowest;
    info.highest = range.highest;
    info.mean = range.sum / range.count;
  }
}

/// "why: remedy" where a grid cannot be felt.
std::string refusalOf(const openvdb::GridBase& grid, const GridInfo& info, bool affine,
                      const std::vector<Volume::Grid::Part>& parts) {
  if (parts.empty()) {
    return "it is of type " + info.type +
           ": convert it to a float, half, double or vec3 grid (points: rasterise them)";
  }
  if (!grid.transform().isLinear()) {
    return "it has a frustum transform: resample it to an affine grid";
  }
  if (!affine) {
    return "its transform is singular or not finite: write it with a valid voxel size";
  }
  if (info.non_finite > 0) {
    return std::to_string(info.non_finite) +
           " of its values are NaN, infinite or above 1e100: replace them before writing the file "
           "(a scene may say \"non_finite\": \"fill\")";
  }
  if (info.active_voxels == 0) {
    return "it has no active voxel: write the grid with its values active";
  }
  const Mat3 size = parts.front().linear.colwise().norm().asDiagonal();
  if (info.was_local && parts.size() == 3 && !parts.front().linear.cwiseAbs().isApprox(size)) {
    return "its staggered vectors are in a rotated index space: write them in world space";
  }
  return "";
}

std::uint64_t memoryOfAll(const std::vector<Volume::Grid::Part>& parts) {
  std::uint64_t sum = 0;
  for (const Volume::Grid::Part& part : parts) {
    sum += memoryOf(part.data);
  }
  return sum;
}

/// Of a vector by component: at the active voxels of the first, the others' nearest.
template <class GridT>
Range magnitudesOf(const std::vector<Volume::Grid::Part>& parts) {
  using Tree = typename GridT::TreeType;
  const auto grid = [&](std::size_t c) -> const GridT& {
    return *std::get<typename GridT::ConstPtr>(parts[c].data);
  };
  const Mat3 y_from_file = parts[1].linear.inverse();
  const Mat3 z_from_file = parts[2].linear.inverse();
  const auto nearest = [](const Vec3& p_I) {
    return Coord::round(openvdb::Vec3d(p_I.x(), p_I.y(), p_I.z()));
  };
  const openvdb::tree::LeafManager<const Tree> leaves(grid(0).tree());
  return tbb::parallel_deterministic_reduce(
      leaves.leafRange(), Range{},
      [&](const auto& some, Range range) {
        const openvdb::tree::ValueAccessor<const Tree, false> y(grid(1).tree());
        const openvdb::tree::ValueAccessor<const Tree, false> z(grid(2).tree());
        for (auto leaf = some.begin(); leaf; ++leaf) {
          for (auto value = leaf->cbeginValueOn(); value; ++value) {
            const Coord c = value.getCoord();
            const Vec3 p_F = parts[0].toFile(Vec3(c.x(), c.y(), c.z()));
            typename GridT::ValueType v{};
            typename GridT::ValueType w{};
            // Where one of them has no data there is no vector.
            if (y.probeValue(nearest(y_from_file * (p_F - parts[1].origin)), v) &&
                z.probeValue(nearest(z_from_file * (p_F - parts[2].origin)), w)) {
              range.add(openvdb::Vec3d(*value, v, w).length(), true);
            }
          }
        }
        return range;
      },
      [](Range a, const Range& b) {
        a.join(b);
        return a;
      });
}

}  // namespace

Prepared prepare(const std::string& name, const openvdb::GridBase::Ptr& base,
                 const LoadOptions& options) {
  Prepared out;
  GridInfo& info = out.info;
  info.name = name;
  info.type = base->valueType();
  info.grid_class = classOf(*base);
  info.half = base->saveFloatAsHalf();
  Volume::Grid::Part part;
  const bool affine = affineMap(*base, part.linear, part.origin);

  std::vector<Volume::Grid::Part> parts;
  const auto take = [&](const auto& grid) {
    if (!grid) return;
    using GridT = typename std::decay_t<decltype(grid)>::element_type;
    prepareValues(*grid, options, affine, info);
    if constexpr (!std::is_arithmetic_v<typename GridT::ValueType>) {
      if (info.grid_class == GridClass::kStaggered) {
        using Scalars = ScalarGrid<typename GridT::ValueType::ValueType>;
        // Each component stands on a face of its voxel, half a voxel below the centre.
        for (int c = 0; c < 3; ++c) {
          Volume::Grid::Part face = part;
          face.origin -= 0.5 * part.linear.col(c);
          face.data = typename Scalars::ConstPtr(componentGrid<Scalars>(*grid, c));
          parts.push_back(std::move(face));
        }
        return;
      }
    }
    part.data = typename GridT::ConstPtr(grid);
    parts.push_back(part);
  };
  take(openvdb::gridPtrCast<openvdb::FloatGrid>(base));
  take(openvdb::gridPtrCast<openvdb::DoubleGrid>(base));
  take(openvdb::gridPtrCast<openvdb::Vec3SGrid>(base));
  take(openvdb::gridPtrCast<openvdb::Vec3DGrid>(base));

  info.active_voxels = base->activeVoxelCount();
  info.memory = base->memUsage();
  openvdb::CoordBBox active = base->evalActiveVoxelBoundingBox();
  if (parts.empty()) takeStatistics(*base, info, active);
  if (parts.size() == 3) info.memory = memoryOfAll(parts);
  if (affine) {
    info.voxel = part.linear.colwise().norm().transpose();
    if (info.active_voxels > 0) info.bounds = boundsOf(active, part);
  }
  if (const auto source = base->getMetadata<openvdb::StringMetadata>("source")) {
    info.source = source->value();
  }
  info.refusal = refusalOf(*base, info, affine, parts);
  out.grid = std::make_unique<Volume::Grid>();
  out.grid->parts = std::move(parts);
  return out;
}

Prepared join(const std::string& name, std::array<Prepared, 3> components) {
  Prepared out;
  GridInfo& info = out.info;
  info = components[0].info;
  info.name = name;
  info.type = "3 x " + info.type;
  info.vector = true;
  info.refusal.clear();
  info.bounds.lower -= 0.5 * info.voxel;
  info.bounds.upper += 0.5 * info.voxel;
  info.filled = info.non_finite = 0;
  out.grid = std::make_unique<Volume::Grid>();
  double squares = 0.0;
  for (Prepared& component : components) {
    const GridInfo& one = component.info;
    if (info.refusal.empty() && !one.refusal.empty()) {
      info.refusal = "its component \"" + one.name + "\" cannot be felt, " + one.refusal;
    }
    info.filled += one.filled;
    info.non_finite += one.non_finite;
    info.active_voxels = std::min(info.active_voxels, one.active_voxels);
    info.voxel = info.voxel.cwiseMin(one.voxel);
    info.smoothing.rms_change = std::max(info.smoothing.rms_change, one.smoothing.rms_change);
    info.smoothing.largest_change =
        std::max(info.smoothing.largest_change, one.smoothing.largest_change);
    // Where all three have data, which reach half a voxel beyond the centres.
    info.bounds.lower = info.bounds.lower.cwiseMax(one.bounds.lower - 0.5 * one.voxel);
    info.bounds.upper = info.bounds.upper.cwiseMin(one.bounds.upper + 0.5 * one.voxel);
    squares += one.background * one.background;
    for (Volume::Grid::Part& part : component.grid->parts) {
      out.grid->parts.push_back(std::move(part));
    }
  }
  info.background = std::sqrt(squares);
  info.memory = memoryOfAll(out.grid->parts);
  if (info.refusal.empty() && info.bounds.empty()) {
    info.refusal = "its components lie apart: write them over the same place";
  }
  if (!info.refusal.empty()) return out;
  const Range range = std::visit(
      [&](const auto& x) -> Range {
        using GridT = std::remove_const_t<typename std::decay_t<decltype(x)>::element_type>;
        if constexpr (std::is_arithmetic_v<typename GridT::ValueType>) {
          return magnitudesOf<GridT>(out.grid->parts);
        } else {
          return {};
        }
      },
      out.grid->parts[0].data);
  if (range.lowest <= range.highest) {
    info.lowest = range.lowest;
    info.highest = range.highest;
    info.mean = range.sum / range.count;
  }
  return out;
}

}  // namespace palpate
