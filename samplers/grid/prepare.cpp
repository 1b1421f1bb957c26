#include "palpate/samplers/grid/prepare.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <type_traits>
#include <utility>

#include <openvdb/tree/LeafManager.h>
#include <tbb/parallel_reduce.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/component_grid.h"
#include "palpate/samplers/grid/labels.h"
#include "palpate/samplers/grid/prepare_values.h"

namespace palpate {
namespace {

using detail::Range;
using openvdb::Coord;

Vec3 vec(const openvdb::Vec3d& v) {
  return {v.x(), v.y(), v.z()};
}

/// Sets file = linear * index + origin. Returns false if the map is not affine, is singular or is
/// not finite.
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

/// Sets the background, and the range and mean of a grid's active values. Returns false if the grid
/// is not a GridT.
template <class GridT>
bool describeValues(const openvdb::GridBase& base, GridInfo& info) {
  if (!base.isType<GridT>()) return false;
  const auto& grid = static_cast<const GridT&>(base);
  Range range;
  for (auto value = grid.cbeginValueOn(); value; ++value) {
    range.add(static_cast<double>(*value), true, static_cast<double>(value.getVoxelCount()));
  }
  info.background = static_cast<double>(grid.background());
  if (range.count > 0.0) {
    info.lowest = range.lowest;
    info.highest = range.highest;
    info.mean = range.sum / range.count;
  }
  return true;
}

/// Describes the values of a grid of a type that fields do not read. Unknown numbers become NaN.
void describeOther(const openvdb::GridBase& base, GridInfo& info) {
  info.lowest = info.highest = info.mean = info.background =
      std::numeric_limits<double>::quiet_NaN();
  (void)(describeValues<openvdb::Int32Grid>(base, info) ||
         describeValues<openvdb::Int64Grid>(base, info) ||
         describeValues<openvdb::BoolGrid>(base, info) ||
         describeValues<openvdb::MaskGrid>(base, info));
}

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

Box boundsOf(const openvdb::CoordBBox& active, const Volume::Grid::Part& part) {
  const auto vec3 = [](const Coord& c) { return Vec3(c.x(), c.y(), c.z()); };
  return boxAbout({vec3(active.min()), vec3(active.max())},
                  [&](const Vec3& p_I) { return part.toFile(p_I); });
}

DataEnds endsOf(const openvdb::GridBase& grid, const openvdb::CoordBBox& active) {
  DataEnds ends;
  if (active.empty()) return ends;
  for (int a = 0; a < 3; ++a) {
    ends.lower[static_cast<std::size_t>(a)] = active.min()[a];
    ends.upper[static_cast<std::size_t>(a)] = active.max()[a];
  }
  ends.inactive = detail::inactiveOf(grid);
  return ends;
}

/// Returns the distance by which smoothing has enlarged the box of active voxels [voxels].
Vec3 growthOf(const detail::ActiveBoxes& active) {
  Vec3 growth = Vec3::Zero();
  if (active.now.empty()) return growth;
  for (int a = 0; a < 3; ++a) {
    growth[a] = std::max({0, active.as_read.min()[a] - active.now.min()[a],
                          active.now.max()[a] - active.as_read.max()[a]});
  }
  return growth;
}

/// Returns "reason: remedy" if the grid is not usable, else an empty string.
std::string refusalOf(const openvdb::GridBase& grid, const GridInfo& info, bool affine,
                      const std::vector<Volume::Grid::Part>& parts) {
  if (parts.empty()) {
    return "its type " + info.type +
           " is not supported: convert it to a float, half, double or vec3 grid (points: rasterise "
           "them)";
  }
  if (!grid.transform().isLinear()) {
    return "it has a frustum transform: resample it to an affine grid";
  }
  if (!affine) {
    return "its transform is singular or not finite: write it with a valid voxel size";
  }
  if (info.non_finite > 0) {
    return std::to_string(info.non_finite) +
           " of its values are NaN, infinite or above 1e100 in size: replace them, or fill them "
           "with the background (\"non_finite\": \"fill\" in a scene, fill=True in Python)";
  }
  if (info.active_voxels == 0) {
    return kNoActiveVoxel;
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

/// Returns the voxels around c in which a grid has one value: a voxel, a tile, or the region of a
/// tile of the root.
template <class Tree>
openvdb::CoordBBox evenAbout(const openvdb::tree::ValueAccessor<const Tree, false>& accessor,
                             const Coord& c) {
  using Root = typename Tree::RootNodeType;
  using Upper = typename Root::ChildNodeType;
  using Lower = typename Upper::ChildNodeType;
  using Leaf = typename Lower::ChildNodeType;
  constexpr std::array<openvdb::Index, 4> kSides{Upper::DIM, Lower::DIM, Leaf::DIM, 1};
  // The depth is -1 where the root has neither a tile nor a node.
  const auto depth = static_cast<std::size_t>(std::max(0, accessor.getValueDepth(c)));
  const auto side = static_cast<openvdb::Int32>(kSides[depth]);
  return openvdb::CoordBBox::createCube(c & ~(side - 1), side);
}

/// Adds the magnitudes of a vector of three grids to a range.
template <class GridT>
class Magnitudes {
  using Tree = typename GridT::TreeType;
  using Value = typename GridT::ValueType;

 public:
  explicit Magnitudes(const std::vector<Volume::Grid::Part>& parts)
      : x_(&parts[0]), others_{Other(parts[1]), Other(parts[2])} {}

  /// Adds the voxels of the first grid in a box, in which this grid has one value. Uses the nearest
  /// voxels of the other two grids. A part of the box in which these have one value is added at
  /// once.
  void add(const openvdb::CoordBBox& box, double x, Range& range) const {
    std::array<double, 2> value{};
    bool even = true;
    for (std::size_t n = 0; n < 2; ++n) {
      const Other& other = others_[n];
      const openvdb::CoordBBox there = other.nearest(*x_, box);
      Value v{};
      const bool active = other.accessor.probeValue(there.min(), v);
      const bool whole = there.min() == there.max() ||
                         evenAbout<Tree>(other.accessor, there.min()).isInside(there);
      // The vector has data only where all three grids have data.
      if (whole && !active) return;
      even = even && whole;
      value[n] = static_cast<double>(v);
    }
    if (even) {
      const double size = openvdb::Vec3d(x, value[0], value[1]).length();
      return range.add(size, true, static_cast<double>(box.volume()));
    }
    // Halves the longest side.
    openvdb::CoordBBox low = box;
    openvdb::CoordBBox high = box;
    const auto axis = static_cast<openvdb::Int32>(box.maxExtent());
    low.max()[axis] = (box.min()[axis] + box.max()[axis]) >> 1;
    high.min()[axis] = low.max()[axis] + 1;
    add(low, x, range);
    add(high, x, range);
  }

 private:
  struct Other {
    const Volume::Grid::Part* part;
    Mat3 index_from_file;
    openvdb::tree::ValueAccessor<const Tree, false> accessor;

    explicit Other(const Volume::Grid::Part& of)
        : part(&of),
          index_from_file(of.linear.inverse()),
          accessor(std::get<typename GridT::ConstPtr>(of.data)->tree()) {}

    /// Returns a box that contains the voxels nearest to those in a box of the grid `of`.
    [[nodiscard]] openvdb::CoordBBox nearest(const Volume::Grid::Part& of,
                                             const openvdb::CoordBBox& box) const {
      openvdb::CoordBBox out;
      const int corners = box.min() == box.max() ? 1 : 8;
      for (int n = 0; n < corners; ++n) {
        const auto end = [&](int a) { return ((n >> a) & 1) != 0 ? box.max()[a] : box.min()[a]; };
        const Vec3 p = index_from_file * (of.toFile(Vec3(end(0), end(1), end(2))) - part->origin);
        out.expand(Coord::round(openvdb::Vec3d(p.x(), p.y(), p.z())));
      }
      return out;
    }
  };

  const Volume::Grid::Part* x_;
  std::array<Other, 2> others_;
};

/// Returns the range of the magnitudes of a vector of three grids, at the active voxels and tiles
/// of the first grid.
template <class GridT>
Range magnitudesOf(const std::vector<Volume::Grid::Part>& parts) {
  using Tree = typename GridT::TreeType;
  const Tree& tree = std::get<typename GridT::ConstPtr>(parts[0].data)->tree();
  const openvdb::tree::LeafManager<const Tree> leaves(tree);
  Range range = tbb::parallel_deterministic_reduce(
      leaves.leafRange(), Range{},
      [&](const auto& some, Range sum) {
        const Magnitudes<GridT> magnitudes(parts);
        for (auto leaf = some.begin(); leaf; ++leaf) {
          for (auto value = leaf->cbeginValueOn(); value; ++value) {
            magnitudes.add(openvdb::CoordBBox(value.getCoord(), value.getCoord()), *value, sum);
          }
        }
        return sum;
      },
      [](Range a, const Range& b) {
        a.join(b);
        return a;
      });
  const Magnitudes<GridT> magnitudes(parts);
  auto tile = tree.cbeginValueOn();
  tile.setMaxDepth(tile.getLeafDepth() - 1);
  for (; tile; ++tile) magnitudes.add(tile.getBoundingBox(), *tile, range);
  return range;
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
  detail::ActiveBoxes active;

  std::vector<Volume::Grid::Part> parts;
  const auto take = [&](const auto& grid) {
    if (!grid) return;
    using GridT = typename std::decay_t<decltype(grid)>::element_type;
    active = detail::prepareValues(*grid, options, affine, info);
    part.ends = endsOf(*grid, active.now);
    part.grown = growthOf(active);
    if constexpr (!std::is_arithmetic_v<typename GridT::ValueType>) {
      if (info.grid_class == GridClass::kStaggered) {
        using Scalars = ScalarGrid<typename GridT::ValueType::ValueType>;
        // Each component belongs to a face, half a voxel below the voxel's centre.
        for (int c = 0; c < 3; ++c) {
          Volume::Grid::Part face = part;
          face.origin -= 0.5 * part.linear.col(c);
          face.data = typename Scalars::ConstPtr(detail::componentGrid(*grid, c));
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
  if (parts.empty()) {
    active.as_read = base->evalActiveVoxelBoundingBox();
    describeOther(*base, info);
    takeStatistics(*base, info, active.as_read);
  }
  if (parts.size() == 3) info.memory = memoryOfAll(parts);
  if (affine) {
    info.voxel = part.linear.colwise().norm().transpose();
    if (info.active_voxels > 0) info.bounds = boundsOf(active.as_read, part);
  }
  const auto text = [&](const char* key) {
    const auto found = base->getMetadata<openvdb::StringMetadata>(key);
    return found ? found->value() : std::string();
  };
  info.source = text("source");
  info.description = text("description");
  info.labels = labelsIn(*base);
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
      info.refusal = "its component \"" + one.name + "\" cannot be used because " + one.refusal;
    }
    info.filled += one.filled;
    info.non_finite += one.non_finite;
    info.active_voxels = std::min(info.active_voxels, one.active_voxels);
    info.voxel = info.voxel.cwiseMin(one.voxel);
    info.smoothing.rms_change = std::max(info.smoothing.rms_change, one.smoothing.rms_change);
    info.smoothing.largest_change =
        std::max(info.smoothing.largest_change, one.smoothing.largest_change);
    // Bounds where all components have data: half a voxel beyond their voxels' centres.
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
    info.refusal = "its components do not overlap: write them over the same region";
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
