/// The downhill simplex of Nelder and Mead (Computer Journal 7, 1965) in three dimensions.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>

#include "palpate/engine/types.h"

namespace palpate::methods {

struct SimplexParams {
  double size = 1e-3;       ///< Edge of the first simplex along the three axes [m].
  double tolerance = 1e-6;  ///< Stops when no vertex is farther than this from the best [m].
  /// Limit, checked once per round: the last round can exceed it by four.
  int max_evaluations = 1000;
};

struct SimplexResult {
  Vec3 best = Vec3::Zero();
  double value = 0.0;  ///< Value at `best`.
  int evaluations = 0;
  bool settled = false;  ///< True if the simplex became smaller than `tolerance` before the limit.
};

/// Minimises `value(Vec3)`; coefficients 1 (reflect), 2 (expand), 1/2 (contract), 1/2 (shrink). RT:
/// no allocation, unless `value` allocates.
template <class Function>
[[nodiscard]] SimplexResult minimiseBySimplex(const Function& value, const Vec3& start,
                                              const SimplexParams& params) {
  struct Vertex {
    Vec3 x;
    double f;
  };
  SimplexResult result;
  const auto at = [&](const Vec3& x) {
    ++result.evaluations;
    return Vertex{x, value(x)};
  };

  std::array<Vertex, 4> simplex;
  simplex[0] = at(start);
  for (int i = 0; i < 3; ++i) {
    simplex[static_cast<std::size_t>(i) + 1] = at(start + params.size * Vec3::Unit(i));
  }
  for (;;) {
    std::sort(simplex.begin(), simplex.end(),
              [](const Vertex& a, const Vertex& b) { return a.f < b.f; });
    const Vertex best = simplex[0];
    Vertex& worst = simplex[3];
    double radius = 0.0;
    for (const Vertex& v : simplex) radius = std::max(radius, (v.x - best.x).norm());
    result.settled = radius <= params.tolerance;
    if (result.settled || result.evaluations >= params.max_evaluations) {
      result.best = best.x;
      result.value = best.f;
      return result;
    }

    // Moves away from the worst vertex, through the middle of the other three.
    const Vec3 middle = (simplex[0].x + simplex[1].x + simplex[2].x) / 3.0;
    const Vec3 away = middle - worst.x;
    const Vertex reflected = at(middle + away);
    if (reflected.f < best.f) {
      const Vertex expanded = at(middle + 2.0 * away);
      worst = expanded.f < reflected.f ? expanded : reflected;
      continue;
    }
    if (reflected.f < simplex[2].f) {
      worst = reflected;
      continue;
    }
    const bool outside = reflected.f < worst.f;
    const Vertex contracted = at(middle + (outside ? 0.5 : -0.5) * away);
    if (contracted.f < std::min(reflected.f, worst.f)) {
      worst = contracted;
      continue;
    }
    for (std::size_t i = 1; i < 4; ++i) simplex[i] = at(best.x + 0.5 * (simplex[i].x - best.x));
  }
}

}  // namespace palpate::methods
