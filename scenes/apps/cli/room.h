/// Stability margin of a coupling on an arm, as three limits (devices/simulated/stability.h).
#pragma once

#include <string>

#include "palpate/engine/balance/coupling.h"
#include "palpate/engine/safety/device.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

/// Returns the stability margin as JSON; null if the arm's mass or friction is unknown. `coupling`
/// is the scene's stiffest. The device's output rate may limit the loop's `rate` [Hz].
[[nodiscard]] OrderedJson roomFor(const DeviceInfo& device, double rate,
                                  const CouplingParams& coupling);
/// Returns true if the coupling is unstable even while a relaxed hand holds the arm. Here and
/// below, `room` is a result of roomFor that is not null.
[[nodiscard]] bool swingsUp(const OrderedJson& room);
/// Returns advice about the coupling, as a sentence without a full stop.
[[nodiscard]] std::string roomWords(const OrderedJson& room);
/// Returns all three limits, on which roomWords bases its advice.
[[nodiscard]] std::string roomNumbers(const OrderedJson& room);
/// Prints the lines `stability`, with text from `column` on. Prints no line if `room` is null, and
/// the numbers only if `verbose`.
void sayRoom(const OrderedJson& room, int column, bool verbose);

}  // namespace palpate::cli
