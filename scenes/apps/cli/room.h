/// Computes the stability margin of a coupling on an arm (devices/simulated/stability.h).
#pragma once

#include <string>

#include "palpate/engine/balance/coupling.h"
#include "palpate/engine/safety/device.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

/// Returns the stability margin as JSON; null if the arm's mass or viscous friction is unknown.
/// `coupling` is the stiffest coupling that can occur in the scene. `rate` is the tick rate of the
/// loop [Hz]. If the device's output is slower, the margin is for the rate of the output.
[[nodiscard]] OrderedJson roomFor(const DeviceInfo& device, double rate,
                                  const CouplingParams& coupling);
/// Returns true if the coupling is unstable even while a relaxed hand holds the arm. In this and
/// the next functions, `room` is a result of roomFor(), but not null.
[[nodiscard]] bool swingsUp(const OrderedJson& room);
/// Returns true if the coupling is stiffer than DeviceInfo::max_stiffness.
[[nodiscard]] bool exceedsDevice(const OrderedJson& room);
/// Returns advice about the coupling: a sentence without a full stop.
[[nodiscard]] std::string roomWords(const OrderedJson& room);
/// Returns the limits on which roomWords bases its advice.
[[nodiscard]] std::string roomNumbers(const OrderedJson& room);
/// Prints the line `stability`, with its text from `column` on, and the limits if `verbose`.
/// Prints no line if `room` is null.
void sayRoom(const OrderedJson& room, int column, bool verbose);

}  // namespace palpate::cli
