/// The balance by the slowest and plainest method that surely finds it: the tests' judge.
#pragma once

#include <span>

#include "engine/primitive.h"

namespace palpate::test {

struct Reference {
  Vec3 offset = Vec3::Zero();  ///< proxy - probe [m]
  double error_bound = 0.0;    ///< [m], by the duality gap in long double, rounding
                               ///< included (the floor: some 1e-11 m for newtons).
  long sweeps = 0;
};

/// Coordinate ascent on the dual in long double, rounding
///< included (the floor: some 1e-11 m for newtons). Each primitive's force lies in a ball
///< (point), a
/// disc (line) or a segment (plane); given the others, its best force is a projection. Sweeps until
/// nothing changes any more, or max_sweeps; the bound says how near it came.
Reference solveReference(const Vec3& probe, double stiffness, std::span<const Primitive> primitives,
                         long max_sweeps = 20000);

}  // namespace palpate::test
