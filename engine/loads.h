/// How primitives share a load where a balance leaves that open.
#pragma once

#include <span>

#include "palpate/engine/primitive.h"
#include "palpate/engine/solver.h"
#include "palpate/engine/types.h"

namespace palpate {

/// Kinks this near to each other share a load [m].
inline constexpr double kSharedWithin = 1e-6;

/// Shares the load anew where a balance can carry it in more than one way: where the proxy is on
/// the kinks of several primitives at once. solveProxy may leave them pressing against each other;
/// here sum |f_i|^2 / s_i is least among kinks at one place, so that a plane on which nothing
/// presses carries nothing. Kinks up to kSharedWithin apart share gradually: the loads that
/// friction and reports need then change continuously with the hand.
///
/// @param result  What solveProxy found for this input; the proxy stays where it is.
/// @param forces  As solveProxy left them; unchanged where no better share is found.
/// RT: no allocation; at most 75 KB of stack. Cost: nothing after a closed form, else a few 3x3
/// solves.
void shareLoads(const Vec3& probe, std::span<const Primitive> primitives, const SolveResult& result,
                std::span<Vec3> forces) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
