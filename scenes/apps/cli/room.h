/// Stability margin of a coupling on an arm, as three limits (devices/simulated/stability.h).
#pragma once

#include <string>

#include "palpate/engine/balance/coupling.h"
#include "palpate/engine/safety/device.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

/// Returns the margin; null if the arm's mass or friction is not known. `coupling`: the stiffest
/// one requested. `rate`: rate of the loop; a force lasts until the device takes the next one.
[[nodiscard]] OrderedJson roomFor(const DeviceInfo& device, double rate,
                                  const CouplingParams& coupling);
/// Returns whether the coupling is unstable even in a relaxed hand. `room` must not be null here
/// and below.
[[nodiscard]] bool swingsUp(const OrderedJson& room);
/// Returns advice about the coupling: a sentence without its final stop.
[[nodiscard]] std::string roomWords(const OrderedJson& room);
/// Returns the numbers behind this advice: all three limits.
[[nodiscard]] std::string roomNumbers(const OrderedJson& room);
/// Prints the report's lines, with text from `column` on; no lines if null. Prints the numbers only
/// if verbose.
void sayRoom(const OrderedJson& room, int column, bool verbose);

}  // namespace palpate::cli
