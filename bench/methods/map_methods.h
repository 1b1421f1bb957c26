/// The engine's solver and the methods of the literature, as methods for maps of couplings.
#pragma once

#include <vector>

#include "palpate/devices/simulated/stability_map.h"

namespace palpate {

/// Returns the engine's solver and six methods of the literature over the contact's fixed
/// primitives, each with one setting. Euler's adaptive step follows the rule in euler_adaptive.h.
/// Euler's fixed step is 1e-2 of 1/k: 1e-3 would take ten times as long.
[[nodiscard]] std::vector<MapMethod> methodsOver(const MapContact& contact);

}  // namespace palpate
