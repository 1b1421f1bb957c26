#include "palpate/scenes/guess/look.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <numeric>
#include <type_traits>

#include <fmt/format.h>
#include <tbb/parallel_for.h>

namespace palpate::guess {
namespace {

using openvdb::Coord;

constexpr std::size_t kBins = 256;
/// A material's dip is lower than its boundaries by this factor: noise alone gives up to 1.5.
constexpr double kContrast = 1.6;
/// Voxels from one material to the next. An image's boundaries are a few voxels wide, wider if
/// smoothed. A mesh is resampled as finely as its cells, or finer: only steps count.
constexpr double kThickestOfImage = 15.0;
constexpr double kThickestOfMesh = 6.0;
constexpr double kLeastOfMesh = 0.01;  ///< Least share of the voxels on either side of a boundary.
/// Front: the values change by this part of their range from one voxel to the next. A shock that a
/// solver has smeared over three cells of two voxels each reaches this; a field that is smooth over
/// 20 voxels does not. A field that is steep nearly everywhere is coarse, or noise.
constexpr double kSteep = 0.08;
constexpr double kMostlySteep = 0.2;   ///< Share of the voxels; with more steep ones there is no
                                       ///< front.
constexpr double kLeastOfFront = 0.7;  ///< Least share of the surface at its value that is steep.
/// Least share of the voxels on either side of a front; fewer are the neighbourhood of a source.
constexpr double kLeastBeside = 0.1;
/// Least share of the gradient integral of the grid's greatest boundary; a lesser boundary is not
/// an object.
constexpr double kLeastShare = 0.05;

std::uint64_t mix(std::uint64_t x) {  // splitmix64
  x += 0x9e3779b97f4a7c15ULL;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
  return x ^ (x >> 31);
}

std::uint64_t mix(const Coord& c) {
  std::uint64_t h = 0;
  for (int axis = 0; axis < 3; ++axis) h = mix(h ^ static_cast<std::uint32_t>(c[axis]));
  return h;
}

/// Reads scalars as floats from any type of grid.
template <class GridT>
class ScalarsOf {
 public:
  using ValueType = float;
  explicit ScalarsOf(const SuggestInput& input)
      : accessor_(static_cast<const GridT&>(*input.grid).getConstAccessor()) {}
  float getValue(const Coord& c) const { return static_cast<float>(accessor_.getValue(c)); }
  bool probeValue(const Coord& c, float& value) const {
    typename GridT::ValueType read{};
    const bool active = accessor_.probeValue(c, read);
    value = static_cast<float>(read);
    return active;
  }

 private:
  typename GridT::ConstAccessor accessor_;
};

/// Reads vectors of floats from one grid, or from one grid for each component.
template <class GridT>
class VectorsOf {
 public:
  using ValueType = openvdb::Vec3f;
  explicit VectorsOf(const SuggestInput& input)
      : accessor_(static_cast<const GridT&>(*input.grid).getConstAccessor()) {}
  openvdb::Vec3f getValue(const Coord& c) const { return openvdb::Vec3f(accessor_.getValue(c)); }
  bool probeValue(const Coord& c, openvdb::Vec3f& value) const {
    typename GridT::ValueType read;
    const bool active = accessor_.probeValue(c, read);
    value = openvdb::Vec3f(read);
    return active;
  }

 private:
  typename GridT::ConstAccessor accessor_;
};
template <class GridT>
class ComponentsOf {
 public:
  using ValueType = openvdb::Vec3f;
  explicit ComponentsOf(const SuggestInput& input)
      : accessors_{of(*input.grid), of(*input.y), of(*input.z)} {}
  openvdb::Vec3f getValue(const Coord& c) const {
    openvdb::Vec3f value;
    (void)probeValue(c, value);
    return value;
  }
  bool probeValue(const Coord& c, openvdb::Vec3f& value) const {
    bool active = true;
    for (int axis = 0; axis < 3; ++axis) {
      typename GridT::ValueType read{};
      active = accessors_[static_cast<std::size_t>(axis)].probeValue(c, read) && active;
      value[axis] = static_cast<float>(read);
    }
    return active;
  }

 private:
  static typename GridT::ConstAccessor of(const openvdb::GridBase& grid) {
    return static_cast<const GridT&>(grid).getConstAccessor();
  }
  std::array<typename GridT::ConstAccessor, 3> accessors_;
};

/// Returns the boxes of a tree's active tiles: nodes with one value for all voxels.
template <class TreeT>
std::vector<openvdb::CoordBBox> tilesOf(const TreeT& tree) {
  std::vector<openvdb::CoordBBox> tiles;
  auto it = tree.cbeginValueOn();
  it.setMaxDepth(TreeT::ValueOnCIter::LEAF_DEPTH - 1);
  for (; it; ++it) tiles.push_back(it.getBoundingBox());
  return tiles;
}

/// Returns the n-th voxel of a box.
Coord voxelOf(const openvdb::CoordBBox& box, std::uint64_t n) {
  const auto y = static_cast<std::uint64_t>(box.dim()[1]);
  const auto z = static_cast<std::uint64_t>(box.dim()[2]);
  return box.min() +
         Coord(static_cast<int>(n / (y * z)), static_cast<int>(n / z % y), static_cast<int>(n % z));
}

/// Returns make(reader, coord) for every n-th active voxel. A hash of its place selects the first
/// voxel in a leaf or tile. Returns about `most` results, those of leaves first, in the order of
/// the tree.
template <class Out, class ReaderT, class GridT, class Make>
std::vector<Out> gather(const SuggestInput& input, std::size_t most, const Make& make) {
  const auto& grid = static_cast<const GridT&>(*input.grid);
  using Leaf = typename GridT::TreeType::LeafNodeType;
  std::vector<const Leaf*> leaves;
  grid.tree().getNodes(leaves);
  const std::vector<openvdb::CoordBBox> tiles = tilesOf(grid.tree());
  const std::uint64_t step = grid.activeVoxelCount() / most + 1;
  constexpr std::size_t kChunk = 256;
  std::vector<std::vector<Out>> parts((leaves.size() + tiles.size() + kChunk - 1) / kChunk);
  tbb::parallel_for(std::size_t{0}, parts.size(), [&](std::size_t part) {
    const ReaderT reader(input);
    const std::size_t end = std::min(leaves.size() + tiles.size(), (part + 1) * kChunk);
    for (std::size_t i = part * kChunk; i < end; ++i) {
      if (i < leaves.size()) {
        std::uint64_t n = mix(leaves[i]->origin()) % step;
        for (auto it = leaves[i]->cbeginValueOn(); it; ++it) {
          if (n++ % step == 0) parts[part].push_back(make(reader, it.getCoord()));
        }
        continue;
      }
      const openvdb::CoordBBox& tile = tiles[i - leaves.size()];
      for (std::uint64_t n = mix(tile.min()) % step; n < tile.volume(); n += step) {
        parts[part].push_back(make(reader, voxelOf(tile, n)));
      }
    }
  });
  std::vector<Out> all;
  for (const auto& part : parts) all.insert(all.end(), part.begin(), part.end());
  return all;
}

/// Returns the edges of a voxel in units of the file.
std::array<double, 3> edgesOf(const openvdb::GridBase& grid) {
  const openvdb::Vec3d origin = grid.transform().indexToWorld(openvdb::Vec3d(0.0));
  std::array<double, 3> edges{};
  for (int axis = 0; axis < 3; ++axis) {
    openvdb::Vec3d p(0.0);
    p[axis] = 1.0;
    edges[static_cast<std::size_t>(axis)] = (grid.transform().indexToWorld(p) - origin).length();
  }
  return edges;
}

Coord beside(Coord c, int axis, int offset) {
  c[axis] += offset;
  return c;
}

struct ScalarSample {
  float value = 0.0F;
  std::array<float, 3> before{};  ///< Neighbours along the axes; the same value if there is no
                                  ///< data.
  std::array<float, 3> after{};
  std::array<bool, 3> known{};
  bool at_edge = false;  ///< A neighbour is in the surroundings.
};

using Bins = std::array<double, kBins>;

/// Applies a Gaussian of 2 bins; the end values continue beyond the ends.
Bins smoothed(const Bins& in) {
  constexpr int kReach = 6;
  Bins out{};
  for (int i = 0; i < static_cast<int>(kBins); ++i) {
    double sum = 0.0;
    double weights = 0.0;
    for (int d = -kReach; d <= kReach; ++d) {
      const int j = std::clamp(i + d, 0, static_cast<int>(kBins) - 1);
      const double weight = std::exp(-0.125 * d * d);
      sum += weight * in[static_cast<std::size_t>(j)];
      weights += weight;
    }
    out[static_cast<std::size_t>(i)] = sum / weights;
  }
  return out;
}

/// Integrals over the isosurface of each level: of 1 (its area) and of the gradient magnitude. A
/// level between the neighbours of a voxel along an axis passes the voxel once. Seen along the
/// axis, this is an area of volume / edge; the true area is larger by |gradient| / |component|.
struct Curve {
  Bins area{};
  Bins gradient{};
  Bins steep{};              ///< Area where values change by kSteep or more in a voxel.
  Bins count{};              ///< Voxels by value.
  double steep_share = 0.0;  ///< Share of the voxels that are steep.
};

Curve curveOf(const std::vector<ScalarSample>& samples, const ScalarLook& look,
              const std::array<double, 3>& edges) {
  // Both grow by steps at the neighbours' levels: add the steps, then form the running sum.
  std::array<double, kBins + 1> area{};
  std::array<double, kBins + 1> gradient{};
  std::array<double, kBins + 1> steep{};
  Curve curve;
  const double edge = std::cbrt(edges[0] * edges[1] * edges[2]);
  const double volume = edges[0] * edges[1] * edges[2];
  const double bins = static_cast<double>(kBins);
  const auto level_from = [&](double value) {  // with levels at the bins' middles
    const double bin = std::ceil((value - look.low) / look.range() * bins - 0.5);
    return static_cast<std::size_t>(std::clamp(bin, 0.0, bins));
  };
  const auto bin_of = [&](double value) {
    const double bin = std::floor((value - look.low) / look.range() * bins);
    return static_cast<std::size_t>(std::clamp(bin, 0.0, bins - 1.0));
  };
  for (const ScalarSample& sample : samples) {
    std::array<double, 3> slope{};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      slope[axis] = std::abs(static_cast<double>(sample.after[axis]) - sample.before[axis]) /
                    (2.0 * edges[axis]);
    }
    const double whole = std::hypot(slope[0], slope[1], slope[2]);
    const bool is_steep = whole * edge >= kSteep * look.range();
    if (is_steep) curve.steep_share += 1.0 / static_cast<double>(samples.size());
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (!(slope[axis] > 0.0)) continue;
      const auto [lower, upper] = std::minmax(sample.before[axis], sample.after[axis]);
      const double seen = volume / edges[axis];
      const std::size_t from = level_from(lower);
      const std::size_t to = level_from(upper);
      area[from] += seen * slope[axis] / whole;
      area[to] -= seen * slope[axis] / whole;
      gradient[from] += seen * slope[axis];
      gradient[to] -= seen * slope[axis];
      if (!is_steep) continue;
      steep[from] += seen * slope[axis] / whole;
      steep[to] -= seen * slope[axis] / whole;
    }
    if (sample.value >= look.low && sample.value <= look.high) {
      curve.count[bin_of(sample.value)] += 1.0;
    }
    // The surroundings of an image are a material too, at the edge of its active voxels.
    if (sample.at_edge && look.outside) curve.count[bin_of(*look.outside)] += 1.0;
  }
  std::partial_sum(area.begin(), area.end() - 1, curve.area.begin());
  std::partial_sum(gradient.begin(), gradient.end() - 1, curve.gradient.begin());
  std::partial_sum(steep.begin(), steep.end() - 1, curve.steep.begin());
  // Where no level passes, the remainder is rounding.
  const double least = 1e-9 * *std::max_element(curve.area.begin(), curve.area.end());
  for (std::size_t i = 0; i < kBins; ++i) {
    if (curve.area[i] <= least) curve.area[i] = curve.gradient[i] = 0.0;
  }
  return curve;
}

/// A material without noise gives no dip but a single full bin, with at least as many voxels as all
/// bins near it.
bool isConstantMaterial(const Bins& count, std::size_t bin) {
  constexpr std::size_t kNear = 32;
  double near = 0.0;
  for (std::size_t i = bin > kNear ? bin - kNear : 0; i < std::min(kBins, bin + kNear + 1); ++i) {
    if (i != bin) near += count[i];
  }
  return count[bin] > 0.0 && count[bin] >= near;
}

/// Alternating dips and peaks; a peak is higher than the dips beside it by the factor kContrast.
struct Turn {
  std::size_t bin = 0;
  bool peak = false;
};

std::vector<Turn> turnsOf(const Bins& mean) {
  std::vector<Turn> turns;
  std::size_t highest = 0;
  std::size_t lowest = 0;
  enum class Way : std::uint8_t { kUnknown, kUp, kDown };
  Way way = Way::kUnknown;
  for (std::size_t i = 1; i < kBins; ++i) {
    if (mean[i] > mean[highest]) highest = i;
    if (mean[i] < mean[lowest]) lowest = i;
    if (way != Way::kDown && kContrast * mean[i] <= mean[highest] && mean[highest] > 0.0) {
      turns.push_back({highest, true});
      way = Way::kDown;
      lowest = i;
    } else if (way != Way::kUp && mean[i] >= kContrast * mean[lowest] && mean[i] > 0.0) {
      turns.push_back({lowest, false});
      way = Way::kUp;
      highest = i;
    }
  }
  if (way == Way::kUp) turns.push_back({highest, true});
  if (way == Way::kDown) turns.push_back({lowest, false});
  return turns;
}

/// Returns the arches of the mean gradient magnitude; see suggest.h.
std::vector<Boundary> boundariesOf(const Curve& curve, const ScalarLook& look, double edge,
                                   bool image) {
  const Bins area = smoothed(curve.area);
  const Bins gradient = smoothed(curve.gradient);
  Bins mean{};
  for (std::size_t i = 0; i < kBins; ++i) {
    mean[i] = area[i] > 0.0 ? gradient[i] / area[i] : (i > 0 ? mean[i - 1] : 0.0);
  }
  for (std::size_t i = 0; i < kBins; ++i) {
    if (isConstantMaterial(curve.count, i)) mean[i] = 0.0;
  }
  const double width = look.range() / static_cast<double>(kBins);
  const auto value_at = [&](std::size_t bin) {
    return look.low + (static_cast<double>(bin) + 0.5) * width;
  };

  std::vector<Boundary> found;
  const std::vector<Turn> turns = turnsOf(mean);
  for (std::size_t t = 0; t < turns.size(); ++t) {
    if (!turns[t].peak) continue;
    Boundary b;
    b.lower_known = t > 0;
    b.upper_known = t + 1 < turns.size();
    const bool closed = b.lower_known && b.upper_known;
    if (!closed && (!image || (!b.lower_known && !b.upper_known))) continue;
    const std::size_t peak = turns[t].bin;
    const std::size_t from = b.lower_known ? turns[t - 1].bin : 0;
    const std::size_t to = b.upper_known ? turns[t + 1].bin : kBins - 1;
    b.lower = b.lower_known ? value_at(from) : look.low;
    b.upper = b.upper_known ? value_at(to) : look.high;
    const auto sum = [&](const Bins& bins) {
      return std::accumulate(bins.begin() + static_cast<std::ptrdiff_t>(from),
                             bins.begin() + static_cast<std::ptrdiff_t>(to) + 1, 0.0);
    };
    b.share = sum(gradient) * width;
    b.slope = sum(gradient) / std::max(sum(area), std::numeric_limits<double>::min());
    if (b.upper - b.lower > (image ? kThickestOfImage : kThickestOfMesh) * edge * b.slope) continue;

    // Two-sided boundaries rise to half the height. One-sided ones rise farther, beyond noise and
    // texture.
    const auto rise = [&](std::size_t dip, double part) {
      const double level = mean[dip] + part * (b.slope - mean[dip]);
      std::size_t i = dip;
      while (i != peak && mean[i] < level) i < peak ? ++i : --i;
      return value_at(i);
    };
    constexpr double kHalf = 0.5;
    constexpr double kTwoThirds = 2.0 / 3.0;
    if (closed) {
      b.value = 0.5 * (rise(from, kHalf) + rise(to, kHalf));
    } else {
      b.value = b.lower_known ? rise(from, kTwoThirds) : rise(to, kTwoThirds);
    }
    b.foot = b.lower_known ? rise(from, kTwoThirds) : b.value;
    // In a mesh, a surface that encloses almost no voxels is not an object but the tail of a field.
    const double above = look.shareAbove(b.value);
    if (!image && std::min(above, 1.0 - above) < kLeastOfMesh) continue;
    found.push_back(b);
  }

  // Keep the greatest three, ordered by value.
  std::stable_sort(found.begin(), found.end(),
                   [](const Boundary& a, const Boundary& b) { return a.share > b.share; });
  if (found.size() > 3) found.resize(3);
  for (std::size_t i = found.size(); i-- > 0;) found[i].share /= found[0].share;
  while (!found.empty() && found.back().share < kLeastShare) found.pop_back();
  std::sort(found.begin(), found.end(),
            [](const Boundary& a, const Boundary& b) { return a.value < b.value; });
  return found;
}

/// Returns the steepest place if it is a surface: the value whose isosurface is steep nearly
/// wherever it runs, like a shock. One side may have any values.
std::optional<Boundary> frontOf(const Curve& curve, const ScalarLook& look) {
  if (curve.steep_share > kMostlySteep) return std::nullopt;
  const Bins area = smoothed(curve.area);
  const Bins steep = smoothed(curve.steep);
  Bins score{};
  for (std::size_t i = 0; i < kBins; ++i) {
    if (area[i] > 0.0 && steep[i] >= kLeastOfFront * area[i]) score[i] = steep[i] / area[i];
  }
  // Find the widest range of values that is steep.
  std::size_t from = 0;
  std::size_t to = 0;
  for (std::size_t i = 0; i < kBins; ++i) {
    if (score[i] <= 0.0) continue;
    std::size_t end = i;
    while (end < kBins && score[end] > 0.0) ++end;
    if (end - i > to - from) {
      from = i;
      to = end;
    }
    i = end;
  }
  // A narrower range is not a front: values change by more from one voxel to the next.
  if (static_cast<double>(to - from) < kSteep * static_cast<double>(kBins)) return std::nullopt;
  const double width = look.range() / static_cast<double>(kBins);
  const auto value_at = [&](std::size_t bin) {
    return look.low + (static_cast<double>(bin) + 0.5) * width;
  };
  Boundary b;
  b.front = true;
  b.lower = value_at(from);
  b.upper = value_at(to - 1);
  b.value = b.foot = 0.5 * (b.lower + b.upper);
  b.share = 1.0;
  const auto bin = (from + to) / 2;
  b.slope = curve.gradient[bin] / std::max(curve.area[bin], std::numeric_limits<double>::min());
  const double above = look.shareAbove(b.value);
  if (std::min(above, 1.0 - above) < kLeastBeside) return std::nullopt;
  return b;
}

/// Finds the share of whole values, the distinct values, and how these touch each other.
void lookAtLabels(const std::vector<ScalarSample>& samples, ScalarLook& look) {
  const auto share = [](double part, double all) { return all > 0.0 ? part / all : 0.0; };
  double whole = 0.0;
  std::vector<float> distinct;
  for (const float value : look.values) {
    // Beyond 2^24 every float is whole.
    whole += value == std::round(value) && std::abs(value) <= 0x1p24F ? 1.0 : 0.0;
    if (distinct.size() <= kMostDistinct && (distinct.empty() || distinct.back() != value)) {
      distinct.push_back(value);
    }
  }
  look.whole = look.range() >= 1.0 ? share(whole, static_cast<double>(look.values.size())) : 0.0;
  if (distinct.size() > kMostDistinct) return;
  // Skip the most frequent value: it surrounds the others and shows nothing of their order.
  float common = look.values.front();
  std::ptrdiff_t most = 0;
  for (const float value : distinct) {
    const auto [from, to] = std::equal_range(look.values.begin(), look.values.end(), value);
    if (to - from > most) {
      most = to - from;
      common = value;
    }
  }
  double pairs = 0.0;
  double alike = 0.0;
  double others = 0.0;
  double skips = 0.0;
  for (const ScalarSample& sample : samples) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      if (!sample.known[axis]) continue;
      for (const float near : {sample.before[axis], sample.after[axis]}) {
        if (near != common && sample.value != common) {
          pairs += 1.0;
          alike += near == sample.value ? 1.0 : 0.0;
        }
        if (near == sample.value) continue;
        others += 1.0;
        const auto [less, more] = std::minmax(near, sample.value);
        const auto next = std::upper_bound(distinct.begin(), distinct.end(), less);
        if (next != distinct.end() && *next < more) skips += 1.0;
      }
    }
  }
  look.alike = share(alike, pairs);
  look.skips = share(skips, others);
  if (look.outside && std::find(distinct.begin(), distinct.end(),
                                static_cast<float>(*look.outside)) == distinct.end()) {
    const auto edge = [](const ScalarSample& sample) { return sample.at_edge; };
    if (std::any_of(samples.begin(), samples.end(), edge)) {
      distinct.push_back(static_cast<float>(*look.outside));
      std::sort(distinct.begin(), distinct.end());
    }
  }
  look.distinct = std::move(distinct);
}

/// Returns the value that marks missing data: a single value at many places, far beyond all others.
/// The others are more values than labels have.
std::optional<float> nothingOf(const std::vector<float>& sorted) {
  constexpr double kMany = 1e-3;
  constexpr double kFar = 10.0;  // in ranges of the others: air is not so far from flesh
  constexpr std::size_t kFew = 64;
  std::size_t distinct = 1;
  for (std::size_t i = 1; i < sorted.size() && distinct <= kFew; ++i) {
    distinct += sorted[i] != sorted[i - 1] ? 1 : 0;
  }
  if (distinct <= kFew) return std::nullopt;
  const auto far_from = [&](float value, double low, double high) {
    return std::max(low - value, value - high) > kFar * (high - low) && high > low;
  };
  for (const float value : {sorted.front(), sorted.back()}) {
    const auto [from, to] = std::equal_range(sorted.begin(), sorted.end(), value);
    const auto count = static_cast<double>(to - from);
    if (count < kMany * static_cast<double>(sorted.size())) continue;
    const bool lowest = from == sorted.begin();
    if (lowest ? to == sorted.end() : from == sorted.begin()) continue;
    const double low = lowest ? *to : sorted.front();
    const double high = lowest ? sorted.back() : *(from - 1);
    if (far_from(value, low, high)) return value;
  }
  return std::nullopt;
}

/// Returns true for the distance to a surface. Values then change by 1 per unit or voxel nearly
/// everywhere, without a common direction, and have both signs.
bool isDistance(const std::vector<ScalarSample>& samples, const std::array<double, 3>& edges,
                double edge) {
  constexpr double kNearlyAll = 0.8;  // a narrow band's ends are cut
  std::size_t count = 0;
  std::size_t per_unit = 0;
  std::size_t per_voxel = 0;
  std::size_t below = 0;
  openvdb::Vec3d mean(0.0);
  for (const ScalarSample& s : samples) {
    if (!s.known[0] || !s.known[1] || !s.known[2]) continue;
    openvdb::Vec3d slope;
    for (std::size_t a = 0; a < 3; ++a) {
      slope[static_cast<int>(a)] =
          (static_cast<double>(s.after[a]) - s.before[a]) / (2.0 * edges[a]);
    }
    const double length = slope.length();
    ++count;
    per_unit += std::abs(length - 1.0) < 0.05 ? 1 : 0;
    per_voxel += std::abs(length * edge - 1.0) < 0.05 ? 1 : 0;
    below += s.value < 0.0F ? 1 : 0;
    if (length > 0.0) mean += slope / length;
  }
  const auto all = static_cast<double>(count);
  const auto share = [all](std::size_t n) { return static_cast<double>(n) / std::max(1.0, all); };
  return std::max(share(per_unit), share(per_voxel)) > kNearlyAll && share(below) > 0.01 &&
         share(below) < 0.99 && mean.length() < 0.5 * all;
}

/// Returns 1 if all values between the 1st and the 99th percentile are equally frequent, 0 if all
/// are equal.
double entropyOf(const std::vector<float>& sorted) {
  const double low = percentile(sorted, 1.0);
  const double high = percentile(sorted, 99.0);
  if (!(high > low)) return 0.0;
  std::array<double, 64> bins{};
  for (const float value : sorted) {
    const double bin = std::floor((value - low) / (high - low) * 64.0);
    bins[static_cast<std::size_t>(std::clamp(bin, 0.0, 63.0))] += 1.0;
  }
  double entropy = 0.0;
  for (const double count : bins) {
    const double part = count / static_cast<double>(sorted.size());
    if (part > 0.0) entropy -= part * std::log(part);
  }
  return entropy / std::log(64.0);
}

/// The neighbours of a voxel along an axis.
template <class Value>
struct Neighbours {
  Value before{};
  Value after{};
  bool known = false;    ///< Both are data.
  bool at_edge = false;  ///< One is in an image's surroundings.
};

template <class Accessor>
auto neighboursOf(const Accessor& accessor, const Coord& c, int axis, const SuggestInput& input) {
  Neighbours<typename Accessor::ValueType> out;
  const Coord before = beside(c, axis, -1);
  const Coord after = beside(c, axis, 1);
  const bool active = static_cast<int>(accessor.probeValue(before, out.before)) +
                          static_cast<int>(accessor.probeValue(after, out.after)) ==
                      2;
  const bool within =
      input.extent.empty() || (input.extent.isInside(before) && input.extent.isInside(after));
  out.known = active || (input.inactive_is_data && within);
  out.at_edge = out.known && !active;
  return out;
}

struct VectorSample {
  openvdb::Vec3f value{0.0F};
  float curl = -1.0F;  ///< Below 0: unknown.
  float jacobian = 0.0F;
};

/// Returns the magnitude of Pearson's correlation of pairs.
double correlation(const std::vector<double>& a, const std::vector<double>& b) {
  const auto n = static_cast<double>(a.size());
  if (a.size() < 8) return 0.0;
  const double mean_a = std::accumulate(a.begin(), a.end(), 0.0) / n;
  const double mean_b = std::accumulate(b.begin(), b.end(), 0.0) / n;
  double aa = 0.0;
  double bb = 0.0;
  double ab = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    aa += (a[i] - mean_a) * (a[i] - mean_a);
    bb += (b[i] - mean_b) * (b[i] - mean_b);
    ab += (a[i] - mean_a) * (b[i] - mean_b);
  }
  return aa > 0.0 && bb > 0.0 ? std::abs(ab) / std::sqrt(aa * bb) : 0.0;
}

/// Calls f with the type of a grid and of its reader.
template <class F>
auto withScalars(const SuggestInput& input, const F& f) {
  using openvdb::DoubleGrid;
  using openvdb::FloatGrid;
  if (input.grid->isType<DoubleGrid>()) {
    return f(std::type_identity<ScalarsOf<DoubleGrid>>(), std::type_identity<DoubleGrid>());
  }
  return f(std::type_identity<ScalarsOf<FloatGrid>>(), std::type_identity<FloatGrid>());
}
template <class F>
auto withVectors(const SuggestInput& input, const F& f) {
  using openvdb::DoubleGrid;
  using openvdb::FloatGrid;
  using openvdb::Vec3DGrid;
  using openvdb::Vec3SGrid;
  if (input.grid->isType<Vec3DGrid>()) {
    return f(std::type_identity<VectorsOf<Vec3DGrid>>(), std::type_identity<Vec3DGrid>());
  }
  if (input.grid->isType<DoubleGrid>()) {
    return f(std::type_identity<ComponentsOf<DoubleGrid>>(), std::type_identity<DoubleGrid>());
  }
  if (input.grid->isType<FloatGrid>()) {
    return f(std::type_identity<ComponentsOf<FloatGrid>>(), std::type_identity<FloatGrid>());
  }
  return f(std::type_identity<VectorsOf<Vec3SGrid>>(), std::type_identity<Vec3SGrid>());
}

/// Returns some active voxels, the same for any scalar of the same topology.
std::vector<Coord> places(const SuggestInput& input, std::size_t count) {
  return withScalars(input, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
    return gather<Coord, R, G>(input, count, [](const R&, const Coord& c) { return c; });
  });
}

/// A scalar's values at some places, and whether the voxels are active.
struct Read {
  std::vector<float> values;
  std::vector<bool> active;
};
Read readAt(const SuggestInput& input, const std::vector<Coord>& at) {
  return withScalars(input, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
    const R reader(input);
    Read read;
    for (const Coord& c : at) {
      float value = 0.0F;
      read.active.push_back(reader.probeValue(c, value));
      read.values.push_back(value);
    }
    return read;
  });
}

/// Returns voxels spread over a box.
std::vector<Coord> spreadIn(const openvdb::CoordBBox& box) {
  constexpr std::uint64_t kPlaces = 20'000;
  const std::uint64_t step = box.volume() / kPlaces + 1;
  std::vector<Coord> at;
  for (std::uint64_t n = 0; n < box.volume(); n += step) {
    at.push_back(voxelOf(box, n + mix(n) % std::min(step, box.volume() - n)));
  }
  return at;
}

/// Returns a lattice on the faces of a box.
std::vector<Coord> facesOf(const openvdb::CoordBBox& box) {
  constexpr int kLines = 32;
  std::vector<Coord> at;
  for (int axis = 0; axis < 3; ++axis) {
    const int b = (axis + 1) % 3;
    const int c = (axis + 2) % 3;
    const auto along = [&](int a, int i) {
      return box.min()[a] +
             static_cast<int>(static_cast<std::int64_t>(box.dim()[a] - 1) * i / (kLines - 1));
    };
    for (int i = 0; i < kLines; ++i) {
      for (int j = 0; j < kLines; ++j) {
        for (const int end : {box.min()[axis], box.max()[axis]}) {
          Coord p;
          p[axis] = end;
          p[b] = along(b, i);
          p[c] = along(c, j);
          at.push_back(p);
        }
      }
    }
  }
  return at;
}

}  // namespace

double percentile(const std::vector<float>& sorted, double percent) {
  if (sorted.empty()) return 0.0;
  const auto last = static_cast<double>(sorted.size() - 1);
  return sorted[static_cast<std::size_t>(std::lround(0.01 * percent * last))];
}

double rounded(double value, double range) {
  if (!(range > 0.0) || !std::isfinite(value)) return std::isfinite(value) ? value : 0.0;
  const double step = std::pow(10.0, std::floor(std::log10(range)) - 3.0);
  if (!(step > 0.0)) return value;
  const double near = std::round(value / step) * step + 0.0;  // no -0
  return std::strtod(fmt::format("{:.12g}", near).c_str(), nullptr);
}

double ScalarLook::shareAbove(double value) const {
  if (values.empty()) return 0.0;
  const auto at = std::upper_bound(values.begin(), values.end(), static_cast<float>(value));
  return static_cast<double>(values.end() - at) / static_cast<double>(values.size());
}

namespace {

double backgroundOf(const openvdb::GridBase& grid) {
  return grid.isType<openvdb::DoubleGrid>()
             ? static_cast<const openvdb::DoubleGrid&>(grid).background()
             : static_cast<const openvdb::FloatGrid&>(grid).background();
}

}  // namespace

ScalarLook lookAtScalar(const SuggestInput& input) {
  const bool image = input.inactive_is_data;
  auto samples =
      withScalars(input, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
        return gather<ScalarSample, R, G>(
            input, kSuggestSamples, [&input](const R& reader, const Coord& c) {
              ScalarSample sample;
              sample.value = reader.getValue(c);
              for (int axis = 0; axis < 3; ++axis) {
                const auto near = neighboursOf(reader, c, axis, input);
                if (!near.known || !std::isfinite(near.before) || !std::isfinite(near.after))
                  continue;
                const auto a = static_cast<std::size_t>(axis);
                sample.before[a] = near.before;
                sample.after[a] = near.after;
                sample.known[a] = true;
                sample.at_edge = sample.at_edge || near.at_edge;
              }
              return sample;
            });
      });
  samples.erase(std::remove_if(samples.begin(), samples.end(),
                               [](const ScalarSample& s) { return !std::isfinite(s.value); }),
                samples.end());
  ScalarLook look;
  if (samples.empty()) return look;
  look.values.reserve(samples.size());
  bool edge_seen = false;
  for (const ScalarSample& sample : samples) {
    look.values.push_back(sample.value);
    edge_seen = edge_seen || sample.at_edge;
  }
  std::sort(look.values.begin(), look.values.end());
  if (const std::optional<float> nothing = nothingOf(look.values)) {
    look.nothing = *nothing;
    std::erase(look.values, *nothing);
    std::erase_if(samples, [&](const ScalarSample& s) { return s.value == *nothing; });
    for (ScalarSample& s : samples) {
      for (std::size_t a = 0; a < 3; ++a) {
        if (s.before[a] != *nothing && s.after[a] != *nothing) continue;
        s.known[a] = s.at_edge = false;
        s.before[a] = s.after[a] = 0.0F;
      }
    }
    edge_seen = std::any_of(samples.begin(), samples.end(),
                            [](const ScalarSample& s) { return s.at_edge; });
  }
  look.low = percentile(look.values, 0.2);
  look.high = percentile(look.values, 99.8);
  if (const double background = backgroundOf(*input.grid);
      image && std::isfinite(background) && !(look.nothing && *look.nothing == background)) {
    look.outside = background;
    if (edge_seen) {
      look.low = std::min(look.low, *look.outside);
      look.high = std::max(look.high, *look.outside);
    }
  }
  if (!(look.range() > 1e-6 * std::max(std::abs(look.low), std::abs(look.high)))) {
    look.low = look.high;
    return look;
  }
  lookAtLabels(samples, look);
  look.entropy = entropyOf(look.values);
  const std::array<double, 3> edges = edgesOf(*input.grid);
  const double edge = std::cbrt(edges[0] * edges[1] * edges[2]);
  look.distance = isDistance(samples, edges, edge);
  const Curve curve = curveOf(samples, look, edges);
  look.boundaries = boundariesOf(curve, look, edge, image);
  if (look.boundaries.empty()) {
    if (const auto front = frontOf(curve, look)) look.boundaries.push_back(*front);
  }
  return look;
}

VectorLook lookAtVector(const SuggestInput& input) {
  const openvdb::GridBase& grid = *input.grid;
  // Use the grid's own axes, which are taken as orthogonal: a rotation into this frame keeps the
  // size of a vector's curl and Jacobian.
  const std::array<double, 3> edges = edgesOf(grid);
  std::array<openvdb::Vec3d, 3> axes;
  const openvdb::Vec3d origin = grid.transform().indexToWorld(openvdb::Vec3d(0.0));
  for (int axis = 0; axis < 3; ++axis) {
    openvdb::Vec3d p(0.0);
    p[axis] = 1.0;
    axes[static_cast<std::size_t>(axis)] = (grid.transform().indexToWorld(p) - origin).unit();
  }
  const auto sample_at = [&](const auto& reader, const Coord& c) {
    VectorSample sample;
    sample.value = reader.getValue(c);
    std::array<std::array<double, 3>, 3> j{};  // d v_row / d x_column
    for (int axis = 0; axis < 3; ++axis) {
      const auto near = neighboursOf(reader, c, axis, input);
      if (!near.known) return sample;
      const auto a = static_cast<std::size_t>(axis);
      const openvdb::Vec3d slope =
          (openvdb::Vec3d(near.after) - openvdb::Vec3d(near.before)) / (2.0 * edges[a]);
      for (std::size_t row = 0; row < 3; ++row) j[row][a] = slope.dot(axes[row]);
    }
    double norm = 0.0;
    for (const auto& row : j) norm += row[0] * row[0] + row[1] * row[1] + row[2] * row[2];
    const double curl = std::hypot(j[2][1] - j[1][2], j[0][2] - j[2][0], j[1][0] - j[0][1]);
    if (!std::isfinite(norm)) return sample;
    sample.curl = static_cast<float>(curl);
    sample.jacobian = static_cast<float>(std::sqrt(norm));
    return sample;
  };
  const auto samples =
      withVectors(input, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
        return gather<VectorSample, R, G>(
            input, kSuggestSamples,
            [&](const R& reader, const Coord& c) { return sample_at(reader, c); });
      });

  VectorLook flow;
  for (const VectorSample& s : samples) {
    if (std::isfinite(s.value.length())) flow.speed.push_back(s.value.length());
  }
  std::sort(flow.speed.begin(), flow.speed.end());
  const double fastest = percentile(flow.speed, 99.8);
  flow.speed.clear();
  // A flow is surrounded by noise, or by zeros.
  constexpr double kStill = 0.01;
  double turning = 0.0;
  double changing = 0.0;
  const openvdb::Vec3f* first = nullptr;
  for (const VectorSample& s : samples) {
    const double speed = s.value.length();
    if (!std::isfinite(speed)) continue;
    if (first == nullptr) first = &s.value;
    if ((s.value - *first).length() > 1e-6 * fastest) flow.constant = false;
    if (!(speed > kStill * fastest)) continue;
    flow.speed.push_back(static_cast<float>(speed));
    if (s.curl < 0.0F) continue;
    flow.curl.push_back(s.curl);
    turning += 0.5 * static_cast<double>(s.curl) * s.curl;
    changing += static_cast<double>(s.jacobian) * s.jacobian;
  }
  if (flow.speed.empty()) flow.constant = true;
  if (changing > 0.0) flow.turning = turning / changing;
  const auto is_unit = [](float length) { return std::abs(length - 1.0F) < 2e-3F; };
  flow.unit = static_cast<double>(std::count_if(flow.speed.begin(), flow.speed.end(), is_unit)) /
              std::max(1.0, static_cast<double>(flow.speed.size()));
  std::sort(flow.speed.begin(), flow.speed.end());
  std::sort(flow.curl.begin(), flow.curl.end());
  return flow;
}

bool isLike(const SuggestInput& scalar, const SuggestInput& other) {
  constexpr double kAlike = 0.97;
  if (scalar.grid->transform() != other.grid->transform()) return false;
  const std::vector<Coord> at = places(scalar, 20'000);
  const std::vector<float> own = readAt(scalar, at).values;
  std::array<std::vector<double>, 4> theirs;
  std::vector<double> ours;
  if (other.isVector()) {
    withVectors(other, [&]<class R, class G>(std::type_identity<R>, std::type_identity<G>) {
      const R reader(other);
      for (std::size_t i = 0; i < at.size(); ++i) {
        const openvdb::Vec3d v(reader.getValue(at[i]));
        if (!std::isfinite(v.length()) || !std::isfinite(own[i])) continue;
        for (int axis = 0; axis < 3; ++axis) {
          theirs[static_cast<std::size_t>(axis)].push_back(v[axis]);
        }
        theirs[3].push_back(v.length());
        ours.push_back(own[i]);
      }
    });
  } else {
    const std::vector<float> values = readAt(other, at).values;
    for (std::size_t i = 0; i < at.size(); ++i) {
      if (!std::isfinite(values[i]) || !std::isfinite(own[i])) continue;
      theirs[0].push_back(values[i]);
      ours.push_back(own[i]);
    }
  }
  return std::any_of(theirs.begin(), theirs.end(), [&](const std::vector<double>& their) {
    return their.size() == ours.size() && correlation(ours, their) > kAlike;
  });
}

namespace {

/// Statistics of several scalars at some places, over all of them or all but one.
class Sums {
 public:
  Sums(const std::vector<const SuggestInput*>& scalars, const std::vector<Coord>& at) {
    reads_.reserve(scalars.size());
    for (const SuggestInput* scalar : scalars) reads_.push_back(readAt(*scalar, at));
    const bool image = scalars.front()->inactive_is_data;
    for (std::size_t i = 0; i < at.size(); ++i) {
      const auto active = [i](const Read& read) { return bool{read.active[i]}; };
      if (image || std::any_of(reads_.begin(), reads_.end(), active)) data_.push_back(i);
    }
  }

  /// Returns the share of places where the scalars add up to 1, each within 0 and 1, without the
  /// one at `without`.
  [[nodiscard]] double ones(std::size_t without) {
    if (totals_.empty()) addUp();
    std::size_t count = 0;
    for (std::size_t n = 0; n < data_.size(); ++n) {
      Total total = totals_[n];
      if (without < reads_.size()) {
        const double value = reads_[without].values[data_[n]];
        total.sum -= value;
        total.beyond -= isFraction(value) ? 0 : 1;
      }
      count += total.beyond == 0 && std::abs(total.sum - 1.0) <= kNear ? 1 : 0;
    }
    return share(count);
  }
  /// Returns the share of places where a scalar other than that at `without` is nearly 1.
  [[nodiscard]] double alone(std::size_t without) const {
    constexpr double kAlone = 0.95;
    std::size_t count = 0;
    for (const std::size_t i : data_) {
      bool found = false;
      for (std::size_t m = 0; m < reads_.size(); ++m) {
        found = found || (m != without && reads_[m].values[i] > kAlone);
      }
      count += found ? 1 : 0;
    }
    return share(count);
  }
  /// Returns the mean of each scalar.
  [[nodiscard]] std::vector<double> means() const {
    std::vector<double> means;
    means.reserve(reads_.size());
    for (const Read& read : reads_) {
      double sum = 0.0;
      for (const std::size_t i : data_) sum += read.values[i];
      means.push_back(sum / std::max(1.0, static_cast<double>(data_.size())));
    }
    return means;
  }

 private:
  struct Total {
    double sum = 0.0;
    int beyond = 0;  ///< Number of values that are not fractions.
  };
  static constexpr double kNear = 0.01;
  static bool isFraction(double value) { return value >= -kNear && value <= 1.0 + kNear; }
  [[nodiscard]] double share(std::size_t count) const {
    return static_cast<double>(count) / std::max(1.0, static_cast<double>(data_.size()));
  }
  void addUp() {
    totals_.resize(data_.size());
    for (const Read& read : reads_) {
      for (std::size_t n = 0; n < data_.size(); ++n) {
        const double value = read.values[data_[n]];
        totals_[n].sum += value;
        totals_[n].beyond += isFraction(value) ? 0 : 1;
      }
    }
  }

  std::vector<Read> reads_;
  std::vector<std::size_t> data_;  ///< Places with data.
  std::vector<Total> totals_;
};

}  // namespace

SumLook lookAtSum(const std::vector<const SuggestInput*>& scalars) {
  SumLook look;
  if (scalars.size() < 2) return look;
  openvdb::CoordBBox box;
  std::vector<Coord> within;
  for (const SuggestInput* scalar : scalars) {
    if (scalar->grid->transform() != scalars.front()->grid->transform()) return look;
    const auto some = places(*scalar, std::max<std::size_t>(1, 20'000 / scalars.size()));
    within.insert(within.end(), some.begin(), some.end());
    box.expand(scalar->extent.empty() ? scalar->grid->evalActiveVoxelBoundingBox()
                                      : scalar->extent);
  }
  constexpr double kNearlyEverywhere = 0.98;
  constexpr double kMost = 0.5;
  Sums sums(scalars, within);
  const std::size_t most = scalars.size() > 2 ? scalars.size() : 0;
  std::size_t without = scalars.size();
  look.is_one = sums.ones(without) >= kNearlyEverywhere;
  for (std::size_t i = 0; !look.is_one && i < most; ++i) {
    look.is_one = sums.ones(i) >= kNearlyEverywhere;
    if (look.is_one) without = i;
  }
  if (!look.is_one) return look;
  if (without < scalars.size()) look.other = without;
  look.at_faces = Sums(scalars, facesOf(box)).means();
  const Sums throughout(scalars, spreadIn(box));
  look.throughout = throughout.means();
  look.apart = throughout.alone(without) > kMost;
  return look;
}

}  // namespace palpate::guess
