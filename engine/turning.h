/// How a surface's plane turns, read where the plane was placed.
#pragma once

#include <span>

#include "engine/mode.h"
#include "engine/properties.h"
#include "engine/scene.h"

namespace palpate {

/// Writes Wall::turn of a surface's plane that the reading at x [m] has placed: dn/dx of its
/// normalised gradient. A plane that it did not place does not turn. Nothing for other modes.
///
/// @param bound  Of the mode, just read at x, or at Body::seen of what moves.
/// RT: no allocation. Cost: within a grid's cell that is kept, no look-up; six samples of a
/// formula.
inline void readTurn(const Mode& mode, const BoundGraph& bound, const Properties& properties,
                     const Vec3& x, std::span<const Body> bodies, ModeMemory& memory) noexcept {
  const Skin* skin = skinOf(mode);
  if (skin == nullptr || !memory.placed) return;
  Wall& wall = memory.wall;
  wall.turn.setZero();
  if (!memory.seen) return;
  const Vec3& gradient = properties.vectors[static_cast<std::size_t>(skin->gradient)].value;
  const Mat3 across = Mat3::Identity() - wall.normal * wall.normal.transpose();
  const Mat3 turn =
      skin->sign / gradient.norm() * across * bound.gradientJacobian(*skin, x, bodies);
  if (turn.allFinite()) wall.turn = turn;
}

}  // namespace palpate
