/// Who carries what, where a balance leaves it open.
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
/// here they do as little as they can, sum |f_i|^2 / s_i is least among kinks at one place. So a
/// plane that nothing presses on carries nothing. Kinks up to kSharedWithin apart share gradually,
/// so that loads change continuously with the hand: what friction and reports need.
///
/// @param result  Of solveProxy for this input; the proxy stays where it is.
/// @param forces  As solveProxy left them. Where no better share is found they stay.
/// RT: no allocation; at most 75 KB of stack. Cost: nothing after a closed form, else a few 3x3
/// solves.
void shareLoads(const Vec3& probe, std::span<const Primitive> primitives, const SolveResult& result,
                std::span<Vec3> forces) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
