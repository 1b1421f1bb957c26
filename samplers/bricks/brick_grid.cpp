#include "palpate/samplers/bricks/brick_grid.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdio>
#include <memory>
#include <mutex>
#include <optional>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>
#include <openvdb/tree/LeafManager.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/brick_codec.h"
#include "palpate/samplers/bricks/bricks.h"
#include "palpate/samplers/bricks/write_bricks.h"
#include "palpate/samplers/grid/prepare.h"
#include "palpate/samplers/grid/volume_grid.h"
#include "palpate/samplers/parallel.h"

namespace palpate {
namespace {

using openvdb::Coord;
using openvdb::CoordBBox;
using Json = nlohmann::ordered_json;

Coord coordOf(const VoxelAt& v) {
  return {v[0], v[1], v[2]};
}
VoxelAt voxelOf(const Coord& c) {
  return {c.x(), c.y(), c.z()};
}

template <class Value>
void copyValue(const Value& from, float* to) {
  if constexpr (std::is_arithmetic_v<Value>) {
    *to = static_cast<float>(from);
  } else {
    for (int c = 0; c < 3; ++c) to[c] = static_cast<float>(from[c]);
  }
}

template <class Value>
std::array<std::uint32_t, 3> bitsOf(const Value& value) {
  std::array<float, 3> numbers{};
  copyValue(value, numbers.data());
  return std::bit_cast<std::array<std::uint32_t, 3>>(numbers);
}

bool isOpenvdbs(const std::string& key) {
  using openvdb::GridBase;
  constexpr std::string_view kFile = "file_";
  return key == GridBase::META_GRID_CLASS || key == GridBase::META_GRID_NAME ||
         key == GridBase::META_IS_LOCAL_SPACE || key == GridBase::META_SAVE_HALF_FLOAT ||
         key == GridBase::META_VECTOR_TYPE || key == GridBase::META_GRID_CREATOR ||
         key.compare(0, kFile.size(), kFile) == 0;
}

/// Returns the metadata as JSON, {"key": {"type": value}}. Omits OpenVDB's own keys, and types that
/// setMetadata() does not read.
std::string metadataOf(const openvdb::GridBase& grid) {
  Json all = Json::object();
  for (auto meta = grid.beginMeta(); meta != grid.endMeta(); ++meta) {
    const openvdb::Metadata& one = *meta->second;
    if (isOpenvdbs(meta->first)) continue;
    Json value;
    if (const auto* text = dynamic_cast<const openvdb::StringMetadata*>(&one)) {
      value = text->value();
    } else if (const auto* flag = dynamic_cast<const openvdb::BoolMetadata*>(&one)) {
      value = flag->value();
    } else if (const auto* number = dynamic_cast<const openvdb::Int32Metadata*>(&one)) {
      value = number->value();
    } else if (const auto* large = dynamic_cast<const openvdb::Int64Metadata*>(&one)) {
      value = large->value();
    } else if (const auto* real = dynamic_cast<const openvdb::FloatMetadata*>(&one)) {
      value = real->value();
    } else if (const auto* fine = dynamic_cast<const openvdb::DoubleMetadata*>(&one)) {
      value = fine->value();
    } else if (const auto* three = dynamic_cast<const openvdb::Vec3IMetadata*>(&one)) {
      value = {three->value().x(), three->value().y(), three->value().z()};
    } else {
      continue;
    }
    all[meta->first] = {{one.typeName(), std::move(value)}};
  }
  // Replaces bytes that are not UTF-8, because dump() would otherwise throw.
  return all.dump(-1, ' ', false, Json::error_handler_t::replace);
}

void setMetadata(const std::string& text, openvdb::GridBase& grid) {
  const Json all = Json::parse(text);
  for (const auto& [key, typed] : all.items()) {
    if (isOpenvdbs(key) || !typed.is_object() || typed.size() != 1) continue;
    const std::string& type = typed.begin().key();
    const Json& value = typed.begin().value();
    if (type == "string" && value.is_string()) {
      grid.insertMeta(key, openvdb::StringMetadata(value.get<std::string>()));
    } else if (type == "bool" && value.is_boolean()) {
      grid.insertMeta(key, openvdb::BoolMetadata(value.get<bool>()));
    } else if (type == "int32" && value.is_number_integer()) {
      grid.insertMeta(key, openvdb::Int32Metadata(value.get<std::int32_t>()));
    } else if (type == "int64" && value.is_number_integer()) {
      grid.insertMeta(key, openvdb::Int64Metadata(value.get<std::int64_t>()));
    } else if (type == "float" && value.is_number()) {
      grid.insertMeta(key, openvdb::FloatMetadata(value.get<float>()));
    } else if (type == "double" && value.is_number()) {
      grid.insertMeta(key, openvdb::DoubleMetadata(value.get<double>()));
    } else if (type == "vec3i" && value.is_array() && value.size() == 3 &&
               std::all_of(value.begin(), value.end(),
                           [](const Json& one) { return one.is_number_integer(); })) {
      grid.insertMeta(key, openvdb::Vec3IMetadata(
                               {value[0].get<int>(), value[1].get<int>(), value[2].get<int>()}));
    }
  }
}

/// Right shift that converts a voxel's coordinate, also a negative one, to its brick's [bits].
constexpr int kBrickShift = 6;
static_assert(1 << kBrickShift == kBrickSide);

template <class GridT>
class GridBoxes {
  using Tree = typename GridT::TreeType;
  using Leaf = typename Tree::LeafNodeType;
  using Above = typename Tree::RootNodeType::ChildNodeType::ChildNodeType;
  using Value = typename GridT::ValueType;
  using Accessor = openvdb::tree::ValueAccessor<const Tree, false>;
  static constexpr std::size_t kComponents = std::is_arithmetic_v<Value> ? 1 : 3;

 public:
  explicit GridBoxes(typename GridT::ConstPtr grid) : grid_(std::move(grid)) {}

  BoxFilled operator()(const BrickBox& box) const {
    const Accessor accessor(grid_->tree());
    const Coord lower = coordOf(box.lower);
    const CoordBBox all(lower, lower.offsetBy(kBrickEdge - 1));
    if (isOneTile(accessor, all, box)) return BoxFilled::kOneValue;
    // Copies one leaf's range at a time. A tile may be in place of a leaf.
    const Coord first = lower & ~(Leaf::DIM - 1U);
    for (int x = first.x(); x <= all.max().x(); x += Leaf::DIM) {
      for (int y = first.y(); y <= all.max().y(); y += Leaf::DIM) {
        for (int z = first.z(); z <= all.max().z(); z += Leaf::DIM) {
          const Coord origin(x, y, z);
          CoordBBox here(origin, origin.offsetBy(Leaf::DIM - 1));
          here.intersect(all);
          copy(accessor, origin, here, box);
        }
      }
    }
    return BoxFilled::kEach;
  }

 private:
  /// If a whole box lies in tiles of one value and state, sets its first voxel and returns true.
  /// The box is not larger than a node above the leaves, so its corners show every node that it
  /// overlaps.
  bool isOneTile(const Accessor& accessor, const CoordBBox& all, const BrickBox& box) const {
    static_assert(Above::DIM >= kBrickEdge);
    const Value value = accessor.getValue(all.min());
    const bool on = accessor.isValueOn(all.min());
    for (int c = 0; c < 8; ++c) {
      const Coord corner((c & 4) != 0 ? all.max().x() : all.min().x(),
                         (c & 2) != 0 ? all.max().y() : all.min().y(),
                         (c & 1) != 0 ? all.max().z() : all.min().z());
      if (accessor.template probeConstNode<Above>(corner) != nullptr ||
          accessor.getValue(corner) != value || accessor.isValueOn(corner) != on) {
        return false;
      }
    }
    copyValue(value, box.values.data());
    box.active[0] = static_cast<std::uint8_t>(on ? 1 : 0);
    return true;
  }

  void copy(const Accessor& accessor, const Coord& origin, const CoordBBox& here,
            const BrickBox& box) const {
    const Leaf* leaf = accessor.probeConstLeaf(origin);
    const Value tile = leaf == nullptr ? accessor.getValue(origin) : Value(0);
    const bool on = leaf == nullptr && accessor.isValueOn(origin);
    const Value* data = leaf == nullptr ? nullptr : leaf->buffer().data();
    for (int x = here.min().x(); x <= here.max().x(); ++x) {
      for (int y = here.min().y(); y <= here.max().y(); ++y) {
        std::size_t to =
            BrickView::numberOf(x - box.lower[0] - kBrickApron, y - box.lower[1] - kBrickApron,
                                here.min().z() - box.lower[2] - kBrickApron);
        openvdb::Index from = Leaf::coordToOffset(Coord(x, y, here.min().z()));
        for (int z = here.min().z(); z <= here.max().z(); ++z, ++to, ++from) {
          const bool active = leaf == nullptr ? on : leaf->isValueOn(from);
          copyValue(leaf == nullptr ? tile : data[from], box.values.data() + to * kComponents);
          box.active[to / 8] |= static_cast<std::uint8_t>((active ? 1U : 0U) << (to % 8));
        }
      }
    }
  }

  typename GridT::ConstPtr grid_;
};

/// A checksum (FNV-1a) of numbers, which depends on their order.
class Sum {
 public:
  void add(std::uint64_t number) noexcept {
    for (int byte = 0; byte < 8; ++byte) {
      hash_ = (hash_ ^ (number & 0xFFU)) * 0x100000001B3U;
      number >>= 8U;
    }
  }
  void add(const Coord& c) noexcept {
    for (int a = 0; a < 3; ++a) add(static_cast<std::uint32_t>(c[a]));
  }
  template <class Value>
  void addValue(const Value& value) {
    add(brickChecksum(std::as_bytes(std::span(&value, 1))));
  }
  [[nodiscard]] std::string text() const {
    std::array<char, 17> digits{};
    std::snprintf(digits.data(), digits.size(), "%016llx", static_cast<unsigned long long>(hash_));
    return digits.data();
  }

 private:
  std::uint64_t hash_ = 0xCBF29CE484222325U;
};

/// Number of leaves in a brick without its apron.
template <class GridT>
constexpr std::size_t kBrickLeaves =
    std::size_t{kBrickSide} * kBrickSide* kBrickSide / GridT::TreeType::LeafNodeType::SIZE;

struct LeafSum {
  VoxelAt origin{};
  std::uint64_t sum = 0;
};

/// Sorts leaves in the order of a tree: by the origin of the upper node, then of the lower node,
/// then of the leaf.
template <class Tree>
void sortAsTree(std::vector<LeafSum>& leaves) {
  using Lower = typename Tree::RootNodeType::ChildNodeType::ChildNodeType;
  using Upper = typename Tree::RootNodeType::ChildNodeType;
  const auto key = [](const LeafSum& leaf) {
    const Coord origin = coordOf(leaf.origin);
    return std::array{origin & ~(Upper::DIM - 1U), origin & ~(Lower::DIM - 1U), origin};
  };
  std::sort(leaves.begin(), leaves.end(),
            [&](const LeafSum& a, const LeafSum& b) { return key(a) < key(b); });
}

template <class Leaf>
LeafSum sumOf(const Leaf& leaf) {
  const auto values = brickChecksum(std::as_bytes(std::span(leaf.buffer().data(), Leaf::SIZE)));
  std::array<std::uint64_t, Leaf::SIZE / 64> words{};
  for (openvdb::Index w = 0; w < words.size(); ++w) {
    words[w] = leaf.valueMask().template getWord<openvdb::Index64>(w);
  }
  return {voxelOf(leaf.origin()),
          (std::uint64_t{values} << 32U) | brickChecksum(std::as_bytes(std::span(words)))};
}

template <class GridT>
std::vector<LeafSum> sumsOf(const GridT& grid) {
  const openvdb::tree::LeafManager<const typename GridT::TreeType> leaves(grid.tree());
  std::vector<LeafSum> sums(leaves.leafCount());
  inParallel(sums.size(), [&](std::size_t n) { sums[n] = sumOf(leaves.leaf(n)); });
  return sums;
}

/// Returns the boxes of the bricks of a share that overlap `box`, the box of the grid's voxels.
std::vector<CoordBBox> bricksOf(const CoordBBox& box, const Share& share) {
  std::vector<CoordBBox> bricks;
  CoordBBox range(box.min() >> kBrickShift, box.max() >> kBrickShift);
  range.min().z() = std::max(range.min().z(), static_cast<int>(share.first));
  range.max().z() = std::min(range.max().z(), static_cast<int>(share.end) - 1);
  if (range.empty()) return bricks;
  for (auto brick = range.begin(); brick; ++brick) {
    const Coord lower = *brick << kBrickShift;
    bricks.emplace_back(lower, lower.offsetBy(kBrickSide - 1));
  }
  return bricks;
}

[[noreturn]] void refuse(const GridInfo& info) {
  const auto colon = info.refusal.find(": ");
  throw VolumeError("grid \"" + info.name + "\"", info.refusal.substr(0, colon),
                    info.refusal.substr(colon + 2));
}

/// Returns the checksums of all leaves of all ranks, in the order in which the whole tree would
/// store the leaves.
template <class GridT>
std::vector<LeafSum> sumsOf(const GridParts& parts, ProcessGroup& group) {
  std::vector<LeafSum> sums;
  std::size_t most = 0;
  for (const Share& share : parts.shares) most += bricksOf(parts.box, share).size();
  sums.reserve(most * kBrickLeaves<GridT>);
  std::mutex adding;
  for (std::size_t p = 0; p < parts.shares.size(); ++p) {
    const GridBox make = parts.open(p);
    const std::vector<CoordBBox> bricks = bricksOf(parts.box, parts.shares[p]);
    inParallel(bricks.size(), [&](std::size_t n) {
      const openvdb::GridBase::Ptr grid = make(bricks[n]);
      const Prepared prepared = prepare(parts.grid->getName(), grid, {});
      // A part of the grid may be empty although the whole grid is not.
      if (!prepared.info.refusal.empty() && prepared.info.active_voxels > 0) refuse(prepared.info);
      const auto own = sumsOf(*openvdb::gridConstPtrCast<GridT>(grid));
      const std::lock_guard lock(adding);
      sums.insert(sums.end(), own.begin(), own.end());
    });
  }
  if (group.size() > 1) sums = gatherAll(group, sums);
  sortAsTree<typename GridT::TreeType>(sums);
  return sums;
}

/// Sets the identity, extent, background and metadata of an input from a grid and the checksums of
/// its leaves.
template <class GridT>
void lookAt(const GridT& grid, const std::vector<LeafSum>& sums, BrickInput& input) {
  using Tree = typename GridT::TreeType;
  using Leaf = typename Tree::LeafNodeType;
  Sum sum;
  CoordBBox extent;
  for (const LeafSum& leaf : sums) {
    const Coord origin = coordOf(leaf.origin);
    sum.add(origin);
    sum.add(leaf.sum);
    extent.expand(CoordBBox(origin, origin.offsetBy(Leaf::DIM - 1)));
  }
  auto tile = grid.tree().cbeginValueAll();
  tile.setMaxDepth(Tree::ValueAllCIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) {
    if (!tile.isValueOn() && *tile == grid.background()) continue;
    CoordBBox box;
    tile.getBoundingBox(box);
    sum.add(box.min());
    sum.add(static_cast<std::uint64_t>(tile.isValueOn() ? 1 : 0));
    sum.addValue(*tile);
    extent.expand(box);
  }
  sum.addValue(grid.background());
  input.identity = std::string(grid.valueType()) + " " + sum.text();
  if (extent.empty()) extent = CoordBBox(Coord(0), Coord(0));
  input.lower = voxelOf(extent.min());
  input.upper = voxelOf(extent.max());
  copyValue(grid.background(), input.background.data());
  input.metadata = metadataOf(grid);
}

template <class GridT>
struct BrickNodes {
  using Leaf = typename GridT::TreeType::LeafNodeType;
  using Value = typename GridT::ValueType;
  struct Tile {
    Coord origin;
    Value value;
    bool active;
  };
  std::vector<std::unique_ptr<Leaf>> leaves;
  std::vector<Tile> tiles;
};

template <class GridT>
BrickNodes<GridT> nodesOf(const BrickView& view, const Coord& origin,
                          const typename GridT::ValueType& background) {
  using Leaf = typename GridT::TreeType::LeafNodeType;
  using Value = typename GridT::ValueType;
  constexpr int kLeaf = Leaf::DIM;
  constexpr int kAlong = kBrickSide / kLeaf;
  // Compares bits, because -0.0 and 0.0 are equal as numbers but different in the file.
  const auto same = [](const Value& a, const Value& b) { return bitsOf(a) == bitsOf(b); };
  BrickNodes<GridT> nodes;
  nodes.leaves.reserve(std::size_t{kAlong} * kAlong * kAlong);
  for (int n = 0; n < kAlong * kAlong * kAlong; ++n) {
    const Coord corner(n / (kAlong * kAlong) * kLeaf, n / kAlong % kAlong * kLeaf,
                       n % kAlong * kLeaf);
    auto leaf = std::make_unique<Leaf>(origin + corner, background);
    bool one = true;
    for (openvdb::Index v = 0; v < Leaf::SIZE; ++v) {
      const Coord c = corner + Leaf::offsetToLocalCoord(v);
      const std::size_t number = BrickView::numberOf(c.x(), c.y(), c.z());
      Value value;
      if constexpr (std::is_arithmetic_v<Value>) {
        value = view.value(number);
      } else {
        value = Value(view.value(number, 0), view.value(number, 1), view.value(number, 2));
      }
      leaf->setValueOnly(v, value);
      leaf->setActiveState(v, view.active(number));
      one = one && same(value, leaf->getValue(0)) && leaf->isValueOn(v) == leaf->isValueOn(0);
    }
    if (one && (leaf->isValueOn(0) || !same(leaf->getValue(0), background))) {
      nodes.tiles.push_back({leaf->origin(), leaf->getValue(0), leaf->isValueOn(0)});
    }
    if (!one) nodes.leaves.push_back(std::move(leaf));
  }
  return nodes;
}

template <class GridT>
openvdb::GridBase::Ptr gridOf(BrickSource& source, std::int32_t level) {
  using Value = typename GridT::ValueType;
  const BrickManifest& manifest = source.manifest();
  const BrickFormat& format = manifest.format();
  const BrickLevel& geometry = manifest.levels()[static_cast<std::size_t>(level)];
  const auto value_of = [](const std::array<float, 3>& v) {
    if constexpr (std::is_arithmetic_v<Value>) {
      return v[0];
    } else {
      return Value(v[0], v[1], v[2]);
    }
  };
  const Value background = value_of(manifest.background());
  const auto entries = manifest.entries(level);
  std::vector<BrickNodes<GridT>> made(entries.size());
  inParallel(entries.size(), [&](std::size_t n) {
    const BrickEntry& entry = entries[n];
    if (entry.kind != BrickKind::kStored) return;
    std::vector<std::byte> slot(format.bytes());
    const BrickArrival arrival = source.read({level, entry.at}, slot);
    if (arrival.status != BrickStatus::kArrived) {
      const auto first = arrival.why.find(": ");
      const auto last = arrival.why.rfind(": ");
      throw VolumeError(arrival.why.substr(0, first),
                        arrival.why.substr(first + 2, last - first - 2),
                        arrival.why.substr(last + 2));
    }
    made[n] = nodesOf<GridT>(BrickView(format, slot.data()), coordOf(geometry.voxelOf(entry.at)),
                             background);
  });
  auto grid = GridT::create(background);
  for (std::size_t n = 0; n < entries.size(); ++n) {
    if (entries[n].kind != BrickKind::kStored) {
      const Coord lower = coordOf(geometry.voxelOf(entries[n].at));
      grid->tree().sparseFill(CoordBBox(lower, lower.offsetBy(kBrickSide - 1)),
                              value_of(entries[n].value), entries[n].kind == BrickKind::kActive);
    }
    for (auto& leaf : made[n].leaves) grid->tree().addLeaf(leaf.release());
    for (const auto& tile : made[n].tiles) {
      grid->tree().addTile(1, tile.origin, tile.value, tile.active);
    }
    made[n] = {};
  }
  return grid;
}

openvdb::math::Transform::Ptr transformOf(const BrickLevel& level) {
  // OpenVDB's matrices multiply row vectors, so the matrix is transposed.
  openvdb::Mat4d map = openvdb::Mat4d::identity();
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) map(c, r) = level.linear(r, c);
    map(3, r) = level.origin[r];
  }
  return openvdb::math::Transform::createLinearTransform(map);
}

openvdb::GridClass classOf(GridClass grid_class) {
  switch (grid_class) {
    case GridClass::kLevelSet:
      return openvdb::GRID_LEVEL_SET;
    case GridClass::kFog:
      return openvdb::GRID_FOG_VOLUME;
    case GridClass::kStaggered:
      return openvdb::GRID_STAGGERED;
    case GridClass::kUnknown:
      return openvdb::GRID_UNKNOWN;
  }
  return openvdb::GRID_UNKNOWN;
}

/// Returns an input without `fill` and without the members that lookAt() sets. Throws VolumeError
/// if the volume does not consist of one grid.
BrickInput inputOf(const GridInfo& info, const std::vector<Volume::Grid::Part>& parts, bool half) {
  if (parts.size() != 1) {
    throw VolumeError(
        "\"" + info.name + "\"", "its components are separate grids or staggered",
        "make bricks of each component, or of one grid of vectors at the voxels' centres");
  }
  BrickInput input;
  input.name = info.name;
  input.grid_class = info.grid_class;
  input.format = {info.vector, half || info.half};
  input.linear = parts[0].linear;
  input.origin = parts[0].origin;
  input.source = info.source;
  return input;
}

template <class GridT>
void takeParts(const GridParts& parts, ProcessGroup& group, BrickInput& input) {
  lookAt(*openvdb::gridConstPtrCast<GridT>(parts.grid), sumsOf<GridT>(parts, group), input);
  input.share = {parts.shares.front().first, parts.shares.back().end};
  input.parts = parts.shares;
  const auto make = std::make_shared<GridBox>();
  input.open = [make, open = parts.open](std::size_t part) {
    *make = nullptr;  // frees the last part before the next one is made
    *make = open(part);
  };
  input.fill = [make](const BrickBox& box) {
    const Coord lower = coordOf(box.lower);
    const auto grid = (*make)(CoordBBox(lower, lower.offsetBy(kBrickEdge - 1)));
    return GridBoxes<GridT>(openvdb::gridConstPtrCast<GridT>(grid))(box);
  };
}

}  // namespace

BrickInput brickInput(const std::shared_ptr<const Volume>& volume, bool half) {
  BrickInput input = inputOf(volume->info(), volume->grid().parts, half);
  std::visit(
      [&](const auto& grid) {
        using GridT = std::remove_const_t<typename std::decay_t<decltype(grid)>::element_type>;
        lookAt(*grid, sumsOf(*grid), input);
        // The function object keeps the volume alive as long as the writer requests boxes.
        input.fill = [volume, boxes = GridBoxes<GridT>(grid)](const BrickBox& box) {
          return boxes(box);
        };
      },
      volume->grid().parts[0].data);
  return input;
}

BrickInput brickInput(const GridParts& parts, ProcessGroup& group) {
  const Prepared prepared = prepare(parts.grid->getName(), parts.grid, {});
  const GridInfo& info = prepared.info;
  if (info.refusal != kNoActiveVoxel) refuse(info);
  BrickInput input = inputOf(info, prepared.grid->parts, false);
  if (info.vector) {
    takeParts<openvdb::Vec3SGrid>(parts, group, input);
  } else {
    takeParts<openvdb::FloatGrid>(parts, group, input);
  }
  return input;
}

std::shared_ptr<const Volume> loadBricks(const std::filesystem::path& folder, std::int32_t level) {
  PosixBricks source(folder);
  return loadBricks(source, level, folder.string());
}

std::shared_ptr<const Volume> loadBricks(BrickSource& source, std::int32_t level,
                                         const std::string& called) {
  const BrickManifest& manifest = source.manifest();
  const auto levels = static_cast<std::int32_t>(manifest.levels().size());
  if (level < 0 || level >= levels) {
    throw VolumeError(called, "it does not have level " + std::to_string(level),
                      "give a level from 0 to " + std::to_string(levels - 1));
  }
  const openvdb::GridBase::Ptr grid = manifest.format().vector
                                          ? gridOf<openvdb::Vec3SGrid>(source, level)
                                          : gridOf<openvdb::FloatGrid>(source, level);
  const GridInfo& info = manifest.info();
  grid->setName(info.name);
  grid->setGridClass(classOf(info.grid_class));
  grid->setSaveFloatAsHalf(info.half);
  setMetadata(manifest.metadata(), *grid);
  try {
    grid->setTransform(transformOf(manifest.levels()[static_cast<std::size_t>(level)]));
  } catch (const openvdb::Exception&) {
    throw VolumeError(called, "its voxels are too small for OpenVDB",
                      "write it in a smaller unit of length, such as mm instead of m");
  }
  return preparedVolume(info.name, grid, called);
}

}  // namespace palpate
