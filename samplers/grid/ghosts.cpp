#include "palpate/samplers/grid/ghosts.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <unordered_map>
#include <variant>
#include <vector>

#include <Eigen/LU>

#include "palpate/engine/error.h"
#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume_grid.h"

namespace palpate {
namespace {

using openvdb::Coord;

/// Smaller pieces are specks. The limit is a cube of two voxels along each edge. Smaller pieces are
/// noise of the values rather than objects to feel, and an isosurface of a scan has thousands.
constexpr std::uint64_t kSpeck = 8;

/// The voxels of a leaf, or of a tile of its size: bit 8 y + z of word x.
using Mask = std::array<std::uint64_t, 8>;
constexpr std::uint64_t kLowest = 0x0101010101010101;  ///< The bits of z = 0.
constexpr std::uint64_t kHighest = kLowest << 7;       ///< The bits of z = 7.
constexpr std::uint64_t kAll = ~std::uint64_t{0};
constexpr Mask kFull{kAll, kAll, kAll, kAll, kAll, kAll, kAll, kAll};

constexpr bool holds(const Mask& mask, int x, int y, int z) noexcept {
  return (mask[static_cast<std::size_t>(x)] >> (8 * y + z) & 1) != 0;
}

constexpr bool meet(const Mask& a, const Mask& b) noexcept {
  for (std::size_t x = 0; x < 8; ++x) {
    if ((a[x] & b[x]) != 0) return true;
  }
  return false;
}

/// Returns the voxels that a leaf's voxels touch in the leaf one step `way` away, -1, 0 or 1 along
/// each axis. In the leaf itself: these voxels and their neighbours.
Mask touched(const Mask& mask, const Coord& way) noexcept {
  Mask out{};
  for (std::size_t x = 0; x < 8; ++x) {
    std::uint64_t bits = mask[x];
    bits = way.z() > 0   ? (bits & kHighest) >> 7
           : way.z() < 0 ? (bits & kLowest) << 7
                         : bits | (bits & ~kHighest) << 1 | (bits & ~kLowest) >> 1;
    bits = way.y() > 0 ? bits >> 56 : way.y() < 0 ? bits << 56 : bits | bits << 8 | bits >> 8;
    if (way.x() == 0) {
      out[x] |= bits;
      if (x > 0) out[x - 1] |= bits;
      if (x < 7) out[x + 1] |= bits;
    } else if (x == (way.x() > 0 ? 7 : 0)) {
      out[7 - x] = bits;
    }
  }
  return out;
}

/// Returns the connected part of a mask that contains its first voxel.
Mask firstPart(const Mask& mask) noexcept {
  Mask part{};
  for (std::size_t x = 0; x < 8; ++x) {
    if (mask[x] == 0) continue;
    part[x] = mask[x] & (~mask[x] + 1);
    break;
  }
  for (;;) {
    Mask grown = touched(part, Coord(0));
    for (std::size_t x = 0; x < 8; ++x) grown[x] &= mask[x];
    if (grown == part) return part;
    part = grown;
  }
}

/// Scales of blocks: leaves and tiles of their size, then the tiles of the two node levels above.
constexpr std::array<int, 3> kEdges{3, 7, 12};  ///< Edges as powers of two [voxels].
constexpr int kScales = 3;

constexpr int log2Edge(int scale) noexcept {
  return kEdges[static_cast<std::size_t>(scale)];
}

/// std::hash of a Coord has 20 bits, and neighbours often have the same hash.
struct HashOfCoord {
  std::size_t operator()(const Coord& at) const noexcept {
    std::uint64_t bits = 0;
    for (const int value : {at.x(), at.y(), at.z()}) {
      bits = (bits ^ static_cast<std::uint32_t>(value)) * 0x9e3779b97f4a7c15;
      bits ^= bits >> 32;
    }
    return bits;
  }
};

/// A connected part of a leaf, or a tile.
struct Segment {
  Coord origin;
  int scale = 0;
  Mask mask = kFull;   ///< Full for a tile.
  std::size_t of = 0;  ///< Index of a segment of the same piece, itself at the root; later of the
                       ///< piece.
};

struct Piece {
  std::uint64_t voxels = 0;
  Vec3 sum_I = Vec3::Zero();  ///< Sum of its voxels' places.
  bool overlaps = false;

  [[nodiscard]] bool isSpeck() const noexcept { return voxels < kSpeck; }
};

/// The matter of one frame, in connected pieces.
class Matter {
 public:
  /// The segments of one leaf, or a tile: [first, last).
  struct Block {
    std::size_t first = 0;
    std::size_t last = 0;
  };

  Matter(const Volume& volume, double level, double sign) : part_(volume.grid().parts.front()) {
    const bool level_set = volume.info().grid_class == GridClass::kLevelSet;
    std::visit(
        [&](const auto& grid) {
          using GridT = std::remove_const_t<typename std::decay_t<decltype(grid)>::element_type>;
          if constexpr (std::is_arithmetic_v<typename GridT::ValueType>) {
            gather(grid->tree(), [=](double value, bool on) {
              return sign * (value - level) < 0.0 && (on || (level_set && value < 0.0));
            });
          }
        },
        part_.data);
    connect();
  }

  [[nodiscard]] const Volume::Grid::Part& part() const noexcept { return part_; }
  [[nodiscard]] const std::vector<Segment>& segments() const noexcept { return segments_; }
  [[nodiscard]] const std::vector<Piece>& pieces() const noexcept { return pieces_; }
  [[nodiscard]] Piece& pieceOf(const Segment& segment) noexcept { return pieces_[segment.of]; }

  /// Returns the leaf or tile, of this scale or larger, that holds a place; empty without matter.
  [[nodiscard]] Block find(const Coord& at, int scale) const noexcept {
    for (; scale < kScales; ++scale) {
      const auto& blocks = blocks_[static_cast<std::size_t>(scale)];
      if (blocks.empty()) continue;
      const auto found = blocks.find(at >> log2Edge(scale));
      if (found != blocks.end()) return found->second;
    }
    return {};
  }

 private:
  template <class TreeT, class IsMatter>
  void gather(const TreeT& tree, const IsMatter& is_matter) {
    using Lower = typename TreeT::RootNodeType::ChildNodeType::ChildNodeType;
    static_assert(TreeT::LeafNodeType::TOTAL == kEdges[0] && Lower::TOTAL == kEdges[1] &&
                  TreeT::RootNodeType::ChildNodeType::TOTAL == kEdges[2]);
    for (auto leaf = tree.cbeginLeaf(); leaf; ++leaf) {
      const auto* values = leaf->buffer().data();
      Mask mask{};
      for (openvdb::Index voxel = 0; voxel < TreeT::LeafNodeType::SIZE; ++voxel) {
        const bool in = is_matter(static_cast<double>(values[voxel]), leaf->isValueOn(voxel));
        mask[voxel >> 6] |= static_cast<std::uint64_t>(in) << (voxel & 63);
      }
      add(leaf->origin(), 0, mask);
    }
    auto tile = tree.cbeginValueAll();
    tile.setMaxDepth(TreeT::ValueAllCIter::LEAF_DEPTH - 1);
    for (; tile; ++tile) {
      if (!is_matter(static_cast<double>(*tile), tile.isValueOn())) continue;
      add(tile.getBoundingBox().min(), static_cast<int>(tile.getLevel()) - 1, kFull);
    }
  }

  void add(const Coord& origin, int scale, Mask mask) {
    Block block{segments_.size(), segments_.size()};
    for (; mask != Mask{}; ++block.last) {
      const Mask part = mask == kFull ? kFull : firstPart(mask);
      segments_.push_back({origin, scale, part, block.last});
      for (std::size_t x = 0; x < 8; ++x) mask[x] &= ~part[x];
    }
    if (block.first == block.last) return;
    blocks_[static_cast<std::size_t>(scale)].emplace(origin >> log2Edge(scale), block);
  }

  [[nodiscard]] std::size_t root(std::size_t segment) noexcept {
    while (segments_[segment].of != segment) {
      segments_[segment].of = segments_[segments_[segment].of].of;
      segment = segments_[segment].of;
    }
    return segment;
  }

  /// Joins segments that touch, and sums up their pieces.
  void connect() {
    for (std::size_t s = 0; s < segments_.size(); ++s) {
      const Segment& segment = segments_[s];
      const bool full = segment.mask == kFull;
      for (int n = 0; n < 27; ++n) {
        const Coord way(n / 9 - 1, n / 3 % 3 - 1, n % 3 - 1);
        if (way == Coord(0)) continue;
        // Most segments that are not full touch no voxel in most directions.
        const Mask reached = full ? kFull : touched(segment.mask, way);
        if (reached == Mask{}) continue;
        // Of two segments of equal scale, one finds the other; otherwise the smaller one finds the
        // larger.
        const int scale = n < 13 ? segment.scale + 1 : segment.scale;
        const Block there = find(segment.origin + (way << log2Edge(segment.scale)), scale);
        for (std::size_t t = there.first; t < there.last; ++t) {
          const std::size_t mine = root(s);
          const std::size_t other = root(t);
          if (mine == other) continue;
          if (!meet(full ? touched(kFull, way) : reached, segments_[t].mask)) continue;
          segments_[std::max(mine, other)].of = std::min(mine, other);
        }
      }
    }
    for (std::size_t s = 0; s < segments_.size(); ++s) {
      Segment& segment = segments_[s];
      // A root comes before all other segments of its piece.
      if (segment.of == s) {
        segment.of = pieces_.size();
        pieces_.emplace_back();
      } else {
        segment.of = segments_[segment.of].of;
      }
      sum(segment, pieces_[segment.of]);
    }
  }

  static void sum(const Segment& segment, Piece& piece) noexcept {
    const Vec3 origin(segment.origin.x(), segment.origin.y(), segment.origin.z());
    if (segment.mask == kFull) {
      const std::uint64_t line = std::uint64_t{1} << log2Edge(segment.scale);
      const std::uint64_t voxels = line * line * line;
      piece.voxels += voxels;
      piece.sum_I += static_cast<double>(voxels) *
                     (origin + Vec3::Constant(0.5 * static_cast<double>(line - 1)));
      return;
    }
    for (int x = 0; x < 8; ++x) {
      std::uint64_t bits = segment.mask[static_cast<std::size_t>(x)];
      piece.voxels += static_cast<std::uint64_t>(std::popcount(bits));
      for (; bits != 0; bits &= bits - 1) {
        const int bit = std::countr_zero(bits);
        piece.sum_I += origin + Vec3(x, bit >> 3, bit & 7);
      }
    }
  }

  const Volume::Grid::Part& part_;
  std::vector<Segment> segments_;
  std::array<std::unordered_map<Coord, Block, HashOfCoord>, kScales> blocks_;
  std::vector<Piece> pieces_;
};

/// Marks overlapping pieces if both frames have the same voxels. Leaves find leaves; the smaller of
/// two tiles finds the larger one.
void overlapInPlace(Matter& a, Matter& b) {
  for (const Segment& segment : a.segments()) {
    const Matter::Block there = b.find(segment.origin, segment.scale);
    for (std::size_t t = there.first; t < there.last; ++t) {
      const Segment& other = b.segments()[t];
      if (!meet(segment.mask, other.mask)) continue;
      a.pieceOf(segment).overlaps = true;
      b.pieceOf(other).overlaps = true;
    }
  }
}

/// Marks overlapping pieces by the centres of a's voxels. Tiles and full leaves, the inside of
/// large pieces, are checked only until their piece's first overlap, and at 16^3 places at most. A
/// piece of b between these places finds the tile by its own voxels, when b is checked against a.
void overlapThroughFile(Matter& a, Matter& b) {
  const Mat3 b_from_file = b.part().linear.inverse();
  const Mat3 turn = b_from_file * a.part().linear;
  const Vec3 shift = b_from_file * (a.part().origin - b.part().origin);
  constexpr double kFarthestIndex = 1e9;  // beyond every index, and an int holds it
  Coord last = Coord::max();
  Matter::Block there;
  const auto look = [&](const Segment& segment, const Vec3& p_I) {
    const Vec3 nearest = (turn * p_I + shift + Vec3::Constant(0.5)).array().floor();
    if (!(nearest.cwiseAbs().maxCoeff() < kFarthestIndex)) return;
    const Coord at(static_cast<int>(nearest.x()), static_cast<int>(nearest.y()),
                   static_cast<int>(nearest.z()));
    const Coord leaf = at >> kEdges[0];
    if (leaf != last) there = b.find(at, 0);
    last = leaf;
    for (std::size_t t = there.first; t < there.last; ++t) {
      const Segment& other = b.segments()[t];
      if (!holds(other.mask, at.x() & 7, at.y() & 7, at.z() & 7)) continue;
      a.pieceOf(segment).overlaps = true;
      b.pieceOf(other).overlaps = true;
    }
  };
  for (const Segment& segment : a.segments()) {
    const Piece& piece = a.pieceOf(segment);
    const bool full = segment.mask == kFull;
    const int edge = 1 << log2Edge(segment.scale);
    const int step = std::max(1, edge / 16);
    for (int i = step / 2; i < edge; i += step) {
      for (int j = step / 2; j < edge; j += step) {
        for (int k = step / 2; k < edge && !(full && piece.overlaps); k += step) {
          if (!full && !holds(segment.mask, i, j, k)) continue;
          const Coord at = segment.origin.offsetBy(i, j, k);
          look(segment, Vec3(at.x(), at.y(), at.z()));
        }
      }
    }
  }
}

void refuse(const Volume& volume) {
  if (!volume.info().vector && volume.grid().parts.size() == 1) return;
  throw VolumeError("grid \"" + volume.info().name + "\"", "its values are vectors",
                    "look for ghosts in a scalar grid, such as a derivation of it");
}

/// Returns the share of a frame's surface where the other frame has no data.
double shareBeyond(const Volume& of, const Volume& other, double level) {
  const Volume::Grid::Part& part = of.grid().parts.front();
  const Volume::Grid::Part& there = other.grid().parts.front();
  const Mat3 from_file = there.linear.inverse();
  std::uint64_t surface = 0;
  std::uint64_t beyond = 0;
  const auto look = [&](const auto& grid, const auto& in) {
    using GridT = std::remove_const_t<std::remove_reference_t<decltype(*grid)>>;
    using OtherT = std::remove_const_t<std::remove_reference_t<decltype(*in)>>;
    if constexpr (std::is_arithmetic_v<typename GridT::ValueType> &&
                  std::is_arithmetic_v<typename OtherT::ValueType>) {
      const auto values = grid->getConstAccessor();
      const auto data = in->getConstAccessor();
      for (auto voxel = grid->cbeginValueOn(); voxel; ++voxel) {
        if (!voxel.isVoxelValue()) continue;
        const Coord at = voxel.getCoord();
        const bool above = static_cast<double>(*voxel) >= level;
        bool crossed = false;
        for (int n = 0; n < 6 && !crossed; ++n) {
          Coord next = at;
          next[n / 2] += n % 2 == 0 ? 1 : -1;
          crossed = values.isValueOn(next) &&
                    (static_cast<double>(values.getValue(next)) >= level) != above;
        }
        if (!crossed) continue;
        ++surface;
        const Vec3 p = from_file * (part.toFile(Vec3(at.x(), at.y(), at.z())) - there.origin);
        const Vec3 nearest = (p + Vec3::Constant(0.5)).array().floor();
        constexpr double kFarthestIndex = 1e9;  // beyond every index, and an int holds it
        const bool on =
            nearest.cwiseAbs().maxCoeff() < kFarthestIndex &&
            data.isValueOn(Coord(static_cast<int>(nearest.x()), static_cast<int>(nearest.y()),
                                 static_cast<int>(nearest.z())));
        beyond += on ? 0 : 1;
      }
    }
  };
  std::visit(look, part.data, there.data);
  return surface > 0 ? static_cast<double>(beyond) / static_cast<double>(surface) : 0.0;
}

}  // namespace

double surfaceBeyondData(const Volume& a, const Volume& b, double level) {
  refuse(a);
  refuse(b);
  return std::max(shareBeyond(a, b, level), shareBeyond(b, a, level));
}

Ghosts ghostsBetween(const Volume& a, const Volume& b, double level, double sign) {
  refuse(a);
  refuse(b);
  Matter first(a, level, sign);
  Matter second(b, level, sign);
  const auto overlap =
      first.part().linear == second.part().linear && first.part().origin == second.part().origin
          ? overlapInPlace
          : overlapThroughFile;
  overlap(first, second);
  overlap(second, first);

  Ghosts found;
  double whole = 0.0;
  double ghostly = 0.0;
  double largest = 0.0;
  for (const Matter* matter : {&first, &second}) {
    const double voxel = std::abs(matter->part().linear.determinant());
    for (const Piece& piece : matter->pieces()) {
      if (piece.isSpeck()) continue;
      const double volume = voxel * static_cast<double>(piece.voxels);
      ++found.of;
      whole += volume;
      if (piece.overlaps) continue;
      ++found.pieces;
      ghostly += volume;
      if (volume <= largest) continue;
      largest = volume;
      found.where = matter->part().toFile(piece.sum_I / static_cast<double>(piece.voxels));
    }
  }
  found.share = whole > 0.0 ? ghostly / whole : 0.0;
  found.size = std::cbrt(largest);
  return found;
}

}  // namespace palpate
