#include "palpate/scenes/apps/import/grids.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>
#include <type_traits>
#include <utility>

#include <Eigen/LU>
#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/quantile.h"
#include "palpate/scenes/apps/import/shared_progress.h"

namespace palpate::importer {
namespace {

using openvdb::Coord;

template <class T, int C>
struct Native {
  const T* data = nullptr;

  using Value = std::conditional_t<C == 1, float, openvdb::Vec3f>;

  [[nodiscard]] Value operator[](std::size_t point) const {
    if constexpr (C == 1) {
      return static_cast<float>(data[point]);
    } else {
      const T* v = data + 3 * point;
      return {static_cast<float>(v[0]), static_cast<float>(v[1]), static_cast<float>(v[2])};
    }
  }
};

bool isFinite(float v) {
  return std::isfinite(v);
}
bool isFinite(const openvdb::Vec3f& v) {
  return std::isfinite(v.x()) && std::isfinite(v.y()) && std::isfinite(v.z());
}
bool isNear(float a, float b, double tolerance) {
  return std::abs(static_cast<double>(a) - static_cast<double>(b)) <= tolerance;
}
bool isNear(const openvdb::Vec3f& a, const openvdb::Vec3f& b, double tolerance) {
  return (openvdb::Vec3d(a) - openvdb::Vec3d(b)).length() <= tolerance;
}

bool isHidden(const Piece& image, std::size_t point) {
  return !image.hidden.none() && image.hidden.as<std::uint8_t>()[point] != 0;
}

/// Returns the index of a point in the slices that are in memory.
std::size_t pointAt(const Piece& image, int i, int j, int k) {
  return (static_cast<std::size_t>(k - image.slices().first) *
              static_cast<std::size_t>(image.size[1]) +
          static_cast<std::size_t>(j)) *
             static_cast<std::size_t>(image.size[0]) +
         static_cast<std::size_t>(i);
}

struct Surroundings {
  float middle = 0.0F;  ///< Median of the values on the image's faces.
  /// On the image's faces, 99 % of the values differ from `middle` by at most `spread`.
  float spread = 0.0F;
};

Surroundings surroundingsOfFaces(std::vector<float> faces) {
  Surroundings out;
  out.middle = quantile(faces, 0.5);
  for (float& value : faces) value = std::abs(value - out.middle);
  out.spread = quantile(faces, 0.99);
  return out;
}

template <class T>
Surroundings surroundingsOf(const Piece& image, const Native<T, 1>& values, const Shared& shared) {
  std::vector<float> faces;
  const auto& n = image.size;
  const Slab own = shared.isKnown() ? Slab() : shared.own(n[2]);
  for (int k = own.first; k < own.end(); ++k) {
    for (int j = 0; j < n[1]; ++j) {
      const bool outer = k == 0 || k == n[2] - 1 || j == 0 || j == n[1] - 1;
      const int step = outer || n[0] == 1 ? 1 : n[0] - 1;
      for (int i = 0; i < n[0]; i += step) {
        const std::size_t point = pointAt(image, i, j, k);
        const float value = values[point];
        if (std::isfinite(value) && !isHidden(image, point)) faces.push_back(value);
      }
    }
  }
  return shared.reduced(faces, &surroundingsOfFaces);
}

enum class Found : std::uint8_t { kValue, kHole, kOutside };

template <class T, int C>
struct OwnVoxels {
  const Piece& image;
  Native<T, C> values;
  std::array<int, 3> size = image.size;

  Found at(const Coord& c, typename Native<T, C>::Value& value) const {
    const Slab held = image.slices();
    if (c.x() < 0 || c.y() < 0 || c.x() >= size[0] || c.y() >= size[1] || c.z() < held.first ||
        c.z() >= held.end()) {
      return Found::kOutside;
    }
    const std::size_t point = pointAt(image, c.x(), c.y(), c.z());
    value = values[point];
    return isFinite(value) && !isHidden(image, point) ? Found::kValue : Found::kHole;
  }
};

/// Computes the values of cubes in an image's bounding box, by trilinear interpolation.
template <class T, int C>
struct Cubes {
  const Piece& image;
  Native<T, C> values;
  std::array<int, 3> size;
  Affine index_from_cube;

  Found at(const Coord& c, typename Native<T, C>::Value& value) const {
    // Rounding can put the last cubes slightly outside the image's last voxels.
    constexpr double kRounding = 1e-9;
    const Vec3 p_I = index_from_cube.linear * Vec3(c.x(), c.y(), c.z()) + index_from_cube.origin;
    std::array<int, 3> low{};
    std::array<double, 3> part{};
    for (std::size_t a = 0; a < 3; ++a) {
      const double last = image.size[a] - 1;
      const double x = p_I[static_cast<Eigen::Index>(a)];
      if (!(x >= -kRounding && x <= last + kRounding)) return Found::kOutside;
      low[a] = static_cast<int>(std::clamp(std::floor(x), 0.0, std::max(last - 1.0, 0.0)));
      part[a] = std::clamp(x - low[a], 0.0, 1.0);
    }
    openvdb::Vec3d sum(0.0);
    for (unsigned corner = 0; corner < 8; ++corner) {
      double weight = 1.0;
      std::array<int, 3> at = low;
      for (std::size_t a = 0; a < 3; ++a) {
        const bool upper = ((corner >> a) & 1U) != 0;
        weight *= upper ? part[a] : 1.0 - part[a];
        if (upper) ++at[a];
      }
      if (weight <= kRounding) continue;
      const std::size_t point = pointAt(image, at[0], at[1], at[2]);
      const auto v = values[point];
      if (!isFinite(v) || isHidden(image, point)) return Found::kHole;
      sum += weight * openvdb::Vec3d(v);
    }
    if constexpr (C == 1) {
      value = static_cast<float>(sum.x());
    } else {
      value = openvdb::Vec3f(sum);
    }
    return Found::kValue;
  }
};

/// Returns true if a voxel of the image, in any rank, has no data.
template <class T, int C>
bool hasHoles(const Piece& image, const Native<T, C>& values, std::size_t count,
              const Shared& shared) {
  const std::size_t to_search = shared.isKnown() ? 0 : count;
  const bool own = tbb::parallel_reduce(
      tbb::blocked_range<std::size_t>(0, to_search, 65536), false,
      [&](const tbb::blocked_range<std::size_t>& part, bool found) {
        for (std::size_t i = part.begin(); i < part.end() && !found; ++i) {
          found = !isFinite(values[i]) || isHidden(image, i);
        }
        return found;
      },
      std::logical_or<>());
  const auto all = gatherOne(shared.group(), static_cast<char>(own));
  return std::find(all.begin(), all.end(), static_cast<char>(true)) != all.end();
}

/// Returns the mean of the neighbours with data of a voxel without data; no value without such
/// neighbours. Slopes in the cells beside a hole read this mean.
template <class Value, class Voxels>
std::optional<Value> meanBeside(const Voxels& voxels, const Coord& c) {
  openvdb::Vec3d sum(0.0);
  int count = 0;
  for (int side = 0; side < 6; ++side) {
    Coord beside = c;
    beside[side / 2] += side % 2 == 0 ? 1 : -1;
    Value value;
    if (voxels.at(beside, value) != Found::kValue) continue;
    sum += openvdb::Vec3d(value);
    ++count;
  }
  if (count == 0) return std::nullopt;
  sum /= count;
  if constexpr (std::is_arithmetic_v<Value>) {
    return static_cast<Value>(sum.x());
  } else {
    return Value(sum);
  }
}

/// The background of an image: voxels within `tolerance` of `value`, inactive unless is_active.
template <class Value>
struct Background {
  Value value{};
  double tolerance = 0.0;
  double spread = 0.0;     ///< Surroundings::spread.
  bool is_active = false;  ///< True if the image has holes: then only holes are inactive.
};

struct Counts {
  std::uint64_t voxels = 0;
  std::uint64_t active = 0;
  std::uint64_t surrounding = 0;  ///< Voxels within the tolerance of the background.
  std::uint64_t holes = 0;
  std::uint64_t loud = 0;  ///< Voxels whose difference from the background exceeds the spread.
  double lowest = std::numeric_limits<double>::infinity();
  double highest = -std::numeric_limits<double>::infinity();

  void add(const Counts& other) {
    voxels += other.voxels;
    active += other.active;
    surrounding += other.surrounding;
    holes += other.holes;
    loud += other.loud;
    lowest = std::min(lowest, other.lowest);
    highest = std::max(highest, other.highest);
  }
};

template <class Leaf, class Voxels, class Value>
std::unique_ptr<Leaf> makeLeaf(const Voxels& voxels, const Coord& origin, const Slab& slices,
                               const Background<Value>& background, Counts& counts) {
  auto leaf = std::make_unique<Leaf>(origin, background.value);
  bool used = false;
  Coord end;
  for (int a = 0; a < 3; ++a) {
    end[a] =
        std::min(origin[a] + static_cast<int>(Leaf::DIM), voxels.size[static_cast<std::size_t>(a)]);
  }
  end.z() = std::min(end.z(), slices.end());
  Coord c;
  for (c.z() = std::max(origin.z(), slices.first); c.z() < end.z(); ++c.z()) {
    for (c.y() = origin.y(); c.y() < end.y(); ++c.y()) {
      for (c.x() = origin.x(); c.x() < end.x(); ++c.x()) {
        Value value;
        const Found found = voxels.at(c, value);
        if (found == Found::kOutside) continue;
        ++counts.voxels;
        if (found == Found::kHole) {
          ++counts.holes;
          if (const auto mean = meanBeside<Value>(voxels, c)) {
            leaf->setValueOnly(Leaf::coordToOffset(c), *mean);
            used = true;
          }
          continue;
        }
        if (isNear(value, background.value, background.tolerance)) {
          ++counts.surrounding;
          if (!background.is_active) continue;
          leaf->setValueOn(Leaf::coordToOffset(c), background.value);
          used = true;
          continue;
        }
        leaf->setValueOn(Leaf::coordToOffset(c), value);
        used = true;
        ++counts.active;
        if (!isNear(value, background.value, background.spread)) ++counts.loud;
        counts.lowest = std::min(counts.lowest, lengthOf(value));
        counts.highest = std::max(counts.highest, lengthOf(value));
      }
    }
  }
  if (!used) leaf.reset();
  return leaf;
}

/// Makes all leaves in the slices, and counts their voxels. The first slice is the first of a leaf.
/// @param made  Receives the leaves, row by row; null: they are freed.
template <class Leaf, class Voxels, class Value>
Counts makeLeaves(const Voxels& voxels, const Slab& slices, const Background<Value>& background,
                  const Progress& progress, std::vector<std::vector<std::unique_ptr<Leaf>>>* made) {
  constexpr int kEdge = static_cast<int>(Leaf::DIM);
  std::array<int, 3> leaves{};
  for (std::size_t a = 0; a < 3; ++a) leaves[a] = (voxels.size[a] + kEdge - 1) / kEdge;
  const int first = slices.first / kEdge;
  leaves[2] = (slices.count + kEdge - 1) / kEdge;
  const int rows = leaves[0] * leaves[2];
  if (made != nullptr) made->resize(static_cast<std::size_t>(rows));
  SharedProgress shared(progress, rows);
  Counts counts;
  std::mutex adding;
  tbb::parallel_for(0, rows, [&](int row) {
    Counts own;
    for (int y = 0; y < leaves[1]; ++y) {
      const Coord origin((row % leaves[0]) * kEdge, y * kEdge, (first + row / leaves[0]) * kEdge);
      auto leaf = makeLeaf<Leaf>(voxels, origin, slices, background, own);
      if (leaf && made != nullptr)
        (*made)[static_cast<std::size_t>(row)].push_back(std::move(leaf));
    }
    {
      const std::lock_guard lock(adding);
      counts.add(own);
    }
    shared.step();
  });
  return counts;
}

template <class Value>
Gridded griddedOf(const Counts& counts, const Background<Value>& background) {
  Gridded out;
  out.voxels = counts.voxels;
  out.active = counts.active;
  out.holes = counts.holes;
  out.lowest = counts.lowest;
  out.highest = counts.highest;
  out.background = lengthOf(background.value);
  out.tolerance = background.tolerance;
  const double spread = background.spread;
  const double range = std::max(out.highest, out.background) - std::min(out.lowest, out.background);
  if (background.is_active) {
    // An image of one value gets no active voxel, which the importer reports.
    if (counts.active > 0 && counts.surrounding > 0) {
      out.active += counts.surrounding;
      out.lowest = std::min(out.lowest, out.background);
      out.highest = std::max(out.highest, out.background);
    }
  } else if (spread > background.tolerance && spread < 0.05 * range &&
             static_cast<double>(counts.loud) < 0.9 * static_cast<double>(counts.active)) {
    out.quieter_tolerance = spread;
    out.quieter_share = static_cast<double>(counts.loud) / static_cast<double>(counts.voxels);
  }
  return out;
}

template <class GridT, class Voxels, class Value>
Gridded build(const Voxels& voxels, const Background<Value>& background, const Progress& progress) {
  using Leaf = typename GridT::TreeType::LeafNodeType;
  std::vector<std::vector<std::unique_ptr<Leaf>>> made;
  const Counts counts = makeLeaves(voxels, Slab{0, voxels.size[2]}, background, progress, &made);
  auto grid = GridT::create(background.value);
  for (auto& row : made) {
    for (auto& leaf : row) grid->tree().addLeaf(leaf.release());
    row.clear();
  }
  Gridded out = griddedOf(counts, background);
  out.grid = grid;
  return out;
}

/// Returns a grid without voxels, and a function that makes them.
/// @param array  Owns the numbers of voxels.values.
template <class GridT, class Voxels, class Value>
Gridded onRequest(const Voxels& voxels, const Array& array, const Background<Value>& background,
                  const Progress& progress, const Shared& shared) {
  using Leaf = typename GridT::TreeType::LeafNodeType;
  const Piece& image = voxels.image;
  Counts counts;
  if (!shared.isKnown()) {
    counts = makeLeaves<Leaf>(voxels, shared.own(image.size[2]), background, progress, nullptr);
  }
  const std::vector<Counts> all = gatherOne(shared.group(), counts);
  counts = {};
  for (const Counts& one : all) counts.add(one);
  Gridded out = griddedOf(counts, background);
  out.grid = GridT::create(background.value);
  out.make = [own = std::make_shared<const Piece>(image), values = array.values,
              native = voxels.values, background](const openvdb::CoordBBox& box) {
    const Voxels here{*own, native};
    auto grid = GridT::create(background.value);
    openvdb::CoordBBox inside(Coord(0),
                              Coord(own->size[0] - 1, own->size[1] - 1, own->size[2] - 1));
    inside.intersect(box);
    if (inside.empty()) return openvdb::GridBase::Ptr(grid);
    constexpr std::size_t kShift = Leaf::LOG2DIM;
    Counts uncounted;
    const openvdb::CoordBBox leaves(inside.min() >> kShift, inside.max() >> kShift);
    for (auto at = leaves.begin(); at; ++at) {
      auto leaf = makeLeaf<Leaf>(here, *at << kShift, Slab{inside.min().z(), inside.dim().z()},
                                 background, uncounted);
      if (leaf) grid->tree().addLeaf(leaf.release());
    }
    return openvdb::GridBase::Ptr(grid);
  };
  return out;
}

struct Lattice {
  std::array<int, 3> size{};
  Affine index_from_cube;
  bool cubes = false;
  bool on_request = false;  ///< True to make voxels on request; only without cubes.
};

template <class T, int C>
Gridded buildOn(const Lattice& lattice, const Piece& image, const Array& array, double tolerance,
                const Progress& progress, const Shared& shared) {
  using GridT = std::conditional_t<C == 1, openvdb::FloatGrid, openvdb::Vec3SGrid>;
  const Native<T, C> values{array.values.as<T>()};
  Background<typename Native<T, C>::Value> background;
  background.tolerance = tolerance;
  background.is_active = hasHoles(image, values, array.values.tuples(), shared);
  if constexpr (C == 1) {
    if (!array.labels) {  // the background of labels is 0
      const Surroundings surroundings = surroundingsOf(image, values, shared);
      background.value = surroundings.middle;
      background.spread = surroundings.spread;
    }
  } else {
    background.value = openvdb::Vec3f(0.0F);
  }
  if (lattice.cubes) {
    return build<GridT>(Cubes<T, C>{image, values, lattice.size, lattice.index_from_cube},
                        background, progress);
  }
  const OwnVoxels<T, C> voxels{image, values};
  return lattice.on_request ? onRequest<GridT>(voxels, array, background, progress, shared)
                            : build<GridT>(voxels, background, progress);
}

template <int C>
Gridded buildAny(const Lattice& lattice, const Piece& image, const Array& array, double tolerance,
                 const Progress& progress, const Shared& shared) {
  return visit(array.values, [&](const auto* data) {
    using T = std::remove_cv_t<std::remove_pointer_t<decltype(data)>>;
    return buildOn<T, C>(lattice, image, array, tolerance, progress, shared);
  });
}

Gridded buildOnLattice(const Lattice& lattice, const Piece& image, const Array& array,
                       double tolerance, const Progress& progress, const Shared& shared) {
  Gridded out = array.values.components() == 1
                    ? buildAny<1>(lattice, image, array, tolerance, progress, shared)
                    : buildAny<3>(lattice, image, array, tolerance, progress, shared);
  out.grid->setName(array.name);
  return out;
}

/// OpenVDB rejects a transform if the volume of a voxel is very small.
/// @param first  Beginning of the remedy.
[[noreturn]] void refuseSmall(const std::string& file, double edge, const std::string& first = "") {
  throw VolumeError(
      file,
      fmt::format("voxels with an edge of {:g}, in the grid's unit, are too small for OpenVDB",
                  edge),
      first + "export the data in a smaller unit of length, for example mm instead of m");
}

openvdb::math::Transform::Ptr transformOf(const Affine& file_from_index, const std::string& file) {
  const Mat3& M = file_from_index.linear;
  const double volume = std::abs(M.determinant());
  const double edges = M.col(0).norm() * M.col(1).norm() * M.col(2).norm();
  if (!file_from_index.origin.allFinite()) {
    throw VolumeError(file, "the position of the first voxel is not finite", "correct the header");
  }
  if (!M.allFinite() || !(volume > 1e-9 * edges)) {
    throw VolumeError(file, "the voxels have no volume: the spacing or the directions are wrong",
                      "correct the header, or the layout in --raw");
  }
  openvdb::Mat4R map;  // OpenVDB multiplies a row vector by the matrix
  map.setIdentity();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) map(column, row) = M(row, column);
    map(3, row) = file_from_index.origin[row];
  }
  try {
    return openvdb::math::Transform::createLinearTransform(map);
  } catch (const openvdb::ArithmeticError&) {
    refuseSmall(file, M.colwise().norm().minCoeff());
  }
}

}  // namespace

openvdb::math::Transform::Ptr cubes(double edge, const openvdb::Vec3d& origin,
                                    const std::string& file) {
  try {
    auto transform = openvdb::math::Transform::createLinearTransform(edge);
    transform->postTranslate(origin);
    return transform;
  } catch (const openvdb::ArithmeticError&) {
    refuseSmall(file, edge, "give a larger --voxel, or ");
  }
}

std::array<int, 3> countCubes(const std::array<double, 3>& sides, double voxel, double slack,
                              const std::string& file) {
  std::array<int, 3> size{};
  double voxels = 1.0;
  for (std::size_t a = 0; a < 3; ++a) {
    const double steps = std::floor(sides[a] / voxel + slack) + 1.0;
    voxels *= steps;
    if (!(steps < 1e6) || !(voxels <= kMostVoxels)) {
      throw VolumeError(
          file,
          fmt::format("the volume would need too many voxels with an edge of {:g}, in the file's "
                      "unit (more than {:g}, or 1e6 along an axis)",
                      voxel, kMostVoxels),
          "give a larger --voxel");
    }
    size[a] = static_cast<int>(steps);
  }
  if (*std::max_element(size.begin(), size.end()) < 2) {
    throw VolumeError(
        file,
        fmt::format("voxels with an edge of {:g}, in the file's unit, are larger than the volume",
                    voxel),
        "give a smaller --voxel");
  }
  return size;
}

Gridded gridFromImage(const Piece& image, const Array& array, double tolerance,
                      const std::string& file, const Progress& progress) {
  const auto transform = transformOf(image.file_from_index, file);
  SingleProcess alone;  // in a process group, every rank makes the whole grid
  Gridded out = buildOnLattice({}, image, array, tolerance, progress, Shared(alone));
  out.grid->setTransform(transform);
  return out;
}

Gridded gridOnRequest(const Piece& image, const Array& array, double tolerance,
                      const std::string& file, const Progress& progress, const Shared& shared) {
  const auto transform = transformOf(image.file_from_index, file);
  Lattice lattice;
  lattice.on_request = true;
  Gridded out = buildOnLattice(lattice, image, array, tolerance, progress, shared);
  out.grid->setTransform(transform);
  return out;
}

Gridded gridOnCubes(const Piece& image, const Array& array, double voxel, double tolerance,
                    const std::string& file, const Progress& progress) {
  (void)transformOf(image.file_from_index, file);  // throws if the transform is singular
  const Affine& map = image.file_from_index;
  Box box;
  for (unsigned corner = 0; corner < 8; ++corner) {
    Vec3 p_I;
    for (std::size_t a = 0; a < 3; ++a) {
      p_I[static_cast<Eigen::Index>(a)] = ((corner >> a) & 1U) != 0 ? image.size[a] - 1 : 0;
    }
    box.extend(map.linear * p_I + map.origin);
  }
  Lattice lattice;
  lattice.cubes = true;
  const Vec3 sides = box.upper - box.lower;
  constexpr double kSlack = 1e-9;
  lattice.size = countCubes({sides.x(), sides.y(), sides.z()}, voxel, kSlack, file);
  const Mat3 index_from_file = map.linear.inverse();
  lattice.index_from_cube.linear = index_from_file * voxel;
  lattice.index_from_cube.origin = index_from_file * (box.lower - map.origin);
  SingleProcess alone;  // in a process group, every rank makes all cubes
  Gridded out = buildOnLattice(lattice, image, array, tolerance, progress, Shared(alone));
  out.grid->setTransform(
      cubes(voxel, openvdb::Vec3d(box.lower.x(), box.lower.y(), box.lower.z()), file));
  return out;
}

}  // namespace palpate::importer
