#include "samplers/volume.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <fstream>
#include <limits>
#include <mutex>
#include <utility>

#include <openvdb/io/File.h>
#include <openvdb/tree/LeafManager.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include "engine/error.h"
#include "samplers/vdb_check.h"
#include "samplers/volume_grid.h"

namespace palpate {
namespace {

void initialise() {
  static std::once_flag once;
  std::call_once(once, [] { openvdb::initialize(); });
}

/// Finite, and small enough that no derivative or spline coefficient of it overflows.
bool isUsable(double v) noexcept {
  return std::abs(v) <= 1e100;
}

/// Lowest, highest and mean of a grid's active values; all stored values count for being finite.
struct Range {
  double sum = 0.0;
  double count = 0.0;
  double lowest = std::numeric_limits<double>::infinity();
  double highest = -std::numeric_limits<double>::infinity();
  std::uint64_t non_finite = 0;

  void add(double v, bool active, double voxels = 1.0) noexcept {
    if (!isUsable(v)) {
      ++non_finite;
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
    non_finite += other.non_finite;
  }
};

template <class T>
double sizeOf(const T& value) noexcept {
  if constexpr (std::is_arithmetic_v<T>) {
    return static_cast<double>(value);
  } else {
    return openvdb::Vec3d(value).length();
  }
}

template <class GridT>
Range rangeOf(const GridT& grid) {
  using Tree = typename GridT::TreeType;
  const openvdb::tree::LeafManager<const Tree> leaves(grid.tree());
  Range range = tbb::parallel_reduce(
      leaves.leafRange(), Range{},
      [](const auto& part, Range sum) {
        for (auto leaf = part.begin(); leaf; ++leaf) {
          for (auto value = leaf->cbeginValueAll(); value; ++value) {
            sum.add(sizeOf(*value), value.isValueOn());
          }
        }
        return sum;
      },
      [](Range a, const Range& b) {
        a.join(b);
        return a;
      });
  // Tiles, above the leaves.
  auto tile = grid.cbeginValueAll();
  tile.setMaxDepth(Tree::ValueAllCIter::LEAF_DEPTH - 1);
  for (; tile; ++tile) {
    range.add(sizeOf(*tile), tile.isValueOn(), static_cast<double>(tile.getVoxelCount()));
  }
  range.add(sizeOf(grid.background()), false);
  return range;
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
    active = openvdb::CoordBBox(openvdb::Coord(low->value()), openvdb::Coord(high->value()));
  }
  if (memory != nullptr) {
    info.memory = static_cast<std::uint64_t>(std::max<std::int64_t>(0, memory->value()));
  }
}

/// Describes a grid and, where it can be felt, wraps it.
std::pair<GridInfo, std::unique_ptr<Volume::Grid>> examine(const std::string& name,
                                                           const openvdb::GridBase::Ptr& base) {
  GridInfo info;
  auto grid = std::make_unique<Volume::Grid>();
  Volume::Grid::Part part;
  info.name = name;
  info.type = base->valueType();
  info.grid_class = classOf(*base);
  info.half = base->saveFloatAsHalf();
  info.active_voxels = base->activeVoxelCount();
  info.memory = base->memUsage();
  openvdb::CoordBBox active = base->evalActiveVoxelBoundingBox();
  if (!isFeltType(base->type())) takeStatistics(*base, info, active);

  const bool affine = affineMap(*base, part.linear, part.origin);
  if (affine) {
    info.voxel = part.linear.colwise().norm().transpose();
    if (info.active_voxels > 0) {
      for (int corner = 0; corner < 8; ++corner) {
        Vec3 p_I;
        for (int a = 0; a < 3; ++a) {
          p_I[a] = (((corner >> a) & 1) != 0) ? active.max()[a] : active.min()[a];
        }
        info.bounds.extend(part.linear * p_I + part.origin);
      }
    }
  }

  bool typed = false;
  const auto take = [&](const auto& pointer, bool vector) {
    if (!pointer) return;
    typed = true;
    info.vector = vector;
    info.background = sizeOf(pointer->background());
    const Range range = rangeOf(*pointer);
    info.non_finite = range.non_finite;
    if (range.lowest <= range.highest) {
      info.lowest = range.lowest;
      info.highest = range.highest;
      info.mean = range.sum / range.count;
    }
    part.data = typename std::decay_t<decltype(*pointer)>::ConstPtr(pointer);
  };
  take(openvdb::gridPtrCast<openvdb::FloatGrid>(base), false);
  take(openvdb::gridPtrCast<openvdb::DoubleGrid>(base), false);
  take(openvdb::gridPtrCast<openvdb::Vec3SGrid>(base), true);
  take(openvdb::gridPtrCast<openvdb::Vec3DGrid>(base), true);

  if (!typed) {
    info.refusal = "it is of type " + info.type +
                   ": convert it to a float, half, double or vec3 grid (points: rasterise them)";
  } else if (!base->transform().isLinear()) {
    info.refusal = "it has a frustum transform: resample it to an affine grid";
  } else if (!affine) {
    info.refusal = "its transform is singular or not finite: write it with a valid voxel size";
  } else if (info.active_voxels == 0) {
    info.refusal = "it has no active voxel: write the grid with its values active";
  } else if (info.non_finite > 0) {
    info.refusal = std::to_string(info.non_finite) +
                   " of its values are NaN or infinite: replace them before writing the file";
  }
  grid->parts.push_back(part);
  return {std::move(info), std::move(grid)};
}

/// An OpenVDB file, checked; its errors turned into ours.
class VdbFile {
 public:
  explicit VdbFile(const std::filesystem::path& path) : path_(path), file_(path.string()) {
    initialise();
    std::error_code error;
    const auto status = std::filesystem::status(path, error);
    if (!std::filesystem::exists(status)) {
      throw VolumeError(path.string(), "no such file", "check the path");
    }
    if (!std::filesystem::is_regular_file(status)) {
      throw VolumeError(path.string(), "it is not a file", "give a .vdb file");
    }
    if (!std::ifstream(path, std::ios::binary).is_open()) {
      throw VolumeError(path.string(), "it cannot be read", "check its permissions");
    }
    if (!isVdb(path)) {
      throw VolumeError(path.string(), "it is not a .vdb file",
                        "convert it, e.g. with palpate import");
    }
    guarded([&] {
      checkVdb(path);
      file_.open(/*delayLoad=*/false);
    });
  }

  [[nodiscard]] std::vector<std::string> names() const {
    std::vector<std::string> names;
    for (auto name = file_.beginName(); name != file_.endName(); ++name) names.push_back(*name);
    return names;
  }

  /// The grid; of a type that cannot be felt, all but its tree.
  openvdb::GridBase::Ptr read(const std::string& name) {
    openvdb::GridBase::Ptr grid;
    guarded([&] {
      grid = file_.readGridMetadata(name);
      if (isFeltType(grid->type())) grid = file_.readGrid(name);
    });
    if (!grid) throw VolumeError(path_.string(), "it is damaged", "copy or write it again");
    return grid;
  }

 private:
  /// OpenVDB's message in one line.
  template <class Body>
  void guarded(Body body) const {
    try {
      body();
    } catch (const Error&) {
      throw;
    } catch (const std::exception& e) {
      std::string why = e.what();
      std::replace(why.begin(), why.end(), '\n', ' ');
      throw VolumeError(path_.string(), "it cannot be read (" + why + ")",
                        "it may be damaged or of a newer format: write it again");
    }
  }

  std::filesystem::path path_;
  openvdb::io::File file_;
};

}  // namespace

Volume::Volume(GridInfo info, std::unique_ptr<const Grid> grid)
    : info_(std::move(info)), grid_(std::move(grid)) {}

Volume::~Volume() = default;

bool isVdb(const std::filesystem::path& file) noexcept {
  std::ifstream stream(file, std::ios::binary);
  std::uint32_t magic = 0;
  stream.read(reinterpret_cast<char*>(&magic), sizeof magic);
  return stream && magic == openvdb::OPENVDB_MAGIC;
}

std::vector<std::string> gridNames(const std::filesystem::path& file) {
  return VdbFile(file).names();
}

std::vector<GridInfo> describeGrids(const std::filesystem::path& file) {
  VdbFile vdb(file);
  std::vector<GridInfo> infos;
  for (const std::string& name : vdb.names()) {
    infos.push_back(examine(name, vdb.read(name)).first);
  }
  if (infos.empty()) throw VolumeError(file.string(), "it holds no grid", "write one into it");
  return infos;
}

std::shared_ptr<const Volume> loadVolume(const std::filesystem::path& file,
                                         const std::string& grid) {
  VdbFile vdb(file);
  const std::vector<std::string> names = vdb.names();
  if (names.empty()) throw VolumeError(file.string(), "it holds no grid", "write one into it");

  std::string all;
  for (const std::string& name : names) all += (all.empty() ? "" : ", ") + name;
  std::string wanted = grid;
  if (wanted.empty()) {
    if (names.size() > 1) {
      throw VolumeError(file.string(), "it holds more than one grid", "name one of " + all);
    }
    wanted = names.front();
  }
  if (std::find(names.begin(), names.end(), wanted) == names.end()) {
    const std::string near = nearestName(wanted, names);
    throw VolumeError(file.string(), "there is no grid \"" + wanted + "\"",
                      near.empty() ? "there are: " + all : "did you mean \"" + near + "\"?");
  }

  auto [info, data] = examine(wanted, vdb.read(wanted));
  if (!info.refusal.empty()) {
    const auto colon = info.refusal.find(": ");
    throw VolumeError(file.string() + ": grid \"" + wanted + "\"", info.refusal.substr(0, colon),
                      info.refusal.substr(colon + 2));
  }
  return std::make_shared<Volume>(std::move(info), std::move(data));
}

const char* wordFor(GridClass grid_class) noexcept {
  switch (grid_class) {
    case GridClass::kUnknown:
      return "unknown";
    case GridClass::kLevelSet:
      return "level set";
    case GridClass::kFog:
      return "fog volume";
    case GridClass::kStaggered:
      return "staggered";
  }
  return "";
}

}  // namespace palpate
