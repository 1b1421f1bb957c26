/// The methods of the literature for maps of couplings, beside the engine's solver.
#pragma once

#include <vector>

#include "palpate/devices/simulated/stability_map.h"

namespace palpate {

/// Returns the engine's solver and six methods of the literature over fixed primitives, each at its
/// intended setting.
[[nodiscard]] std::vector<MapMethod> methodsOver(const MapContact& contact);

}  // namespace palpate
