#include "palpate/samplers/grid/free_map.h"

#include <limits>

namespace palpate {
namespace {

constexpr int kFinestEdge = 8;
constexpr std::size_t kMostBlocks = std::size_t{1} << 22;
constexpr std::uint8_t kFarthestCell = std::numeric_limits<std::uint8_t>::max();

std::int64_t floorTo(std::int64_t x, std::int64_t edge) {
  const std::int64_t rest = x % edge;
  return x - (rest < 0 ? rest + edge : rest);
}

/// Computes the Chebyshev distance of all blocks to the nearest zero, in two passes (Rosenfeld,
/// Pfaltz 1968). The first pass uses the neighbours before each block, the second those after it.
void spread(std::vector<std::uint8_t>& distance, const std::array<std::size_t, 3>& size) {
  std::array<std::int64_t, 3> n{};
  for (std::size_t a = 0; a < 3; ++a) n[a] = static_cast<std::int64_t>(size[a]);
  const auto pass = [&](std::int64_t sign) {
    const auto visit = [&](std::int64_t i, std::int64_t j, std::int64_t k) {
      std::uint8_t& here = distance[static_cast<std::size_t>((i * n[1] + j) * n[2] + k)];
      if (here == 0) return;
      int least = here;
      for (int d = 1; d <= 13; ++d) {
        // Visits the thirteen neighbours that come before this block in the order of the pass.
        const std::int64_t x = i - sign * ((d + 13) / 9 - 1);
        const std::int64_t y = j - sign * ((d + 13) / 3 % 3 - 1);
        const std::int64_t z = k - sign * ((d + 13) % 3 - 1);
        if (x < 0 || x >= n[0] || y < 0 || y >= n[1] || z < 0 || z >= n[2]) continue;
        const int there = distance[static_cast<std::size_t>((x * n[1] + y) * n[2] + z)];
        least = std::min(least, there + 1);
      }
      here = static_cast<std::uint8_t>(least);
    };
    const auto along = [&](std::int64_t count, auto&& body) {
      for (std::int64_t i = 0; i < count; ++i) body(sign > 0 ? i : count - 1 - i);
    };
    along(n[0], [&](std::int64_t i) {
      along(n[1], [&](std::int64_t j) { along(n[2], [&](std::int64_t k) { visit(i, j, k); }); });
    });
  };
  pass(1);
  pass(-1);
}

}  // namespace

FreeMap::FreeMap(std::span<const Voxels> data) {
  if (data.empty()) return;
  Voxels all = data.front();
  for (const Voxels& box : data) {
    for (std::size_t a = 0; a < 3; ++a) {
      all.lower[a] = std::min(all.lower[a], box.lower[a]);
      all.upper[a] = std::max(all.upper[a], box.upper[a]);
    }
  }
  std::int64_t edge = kFinestEdge;
  std::array<std::int64_t, 3> lower{};
  for (;; edge *= 2) {
    double blocks = 1.0;
    for (std::size_t a = 0; a < 3; ++a) {
      lower[a] = floorTo(all.lower[a], edge);
      size_[a] = static_cast<std::size_t>((all.upper[a] - lower[a]) / edge + 1);
      lower_[a] = static_cast<double>(lower[a]);
      blocks *= static_cast<double>(size_[a]);
    }
    if (blocks <= static_cast<double>(kMostBlocks)) break;
  }
  edge_ = static_cast<double>(edge);
  per_edge_ = 1.0 / edge_;
  distance_.assign(size_[0] * size_[1] * size_[2], kFarthestCell);
  for (const Voxels& box : data) {
    std::array<std::size_t, 3> first{};
    std::array<std::size_t, 3> last{};
    for (std::size_t a = 0; a < 3; ++a) {
      first[a] = static_cast<std::size_t>((box.lower[a] - lower[a]) / edge);
      last[a] = static_cast<std::size_t>((box.upper[a] - lower[a]) / edge);
    }
    for (std::size_t i = first[0]; i <= last[0]; ++i) {
      for (std::size_t j = first[1]; j <= last[1]; ++j) {
        const std::size_t line = (i * size_[1] + j) * size_[2];
        std::fill(distance_.begin() + static_cast<std::ptrdiff_t>(line + first[2]),
                  distance_.begin() + static_cast<std::ptrdiff_t>(line + last[2] + 1),
                  std::uint8_t{0});
      }
    }
  }
  spread(distance_, size_);
}

}  // namespace palpate
