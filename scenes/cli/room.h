/// What a coupling has room for on an arm, in three numbers (devices/stability.h).
#pragma once

#include <string>

#include "palpate/engine/coupling.h"
#include "palpate/engine/device.h"
#include "palpate/scenes/cli/common.h"

namespace palpate::cli {

/// Null where the arm's mass or friction is not known. `coupling`: the stiffest that is asked for.
/// `rate`: the loop's; a force lasts until the device takes the next one.
[[nodiscard]] OrderedJson roomFor(const DeviceInfo& device, double rate,
                                  const CouplingParams& coupling);
/// In words, of JSON that is not null; one line, without its end.
[[nodiscard]] std::string roomWords(const OrderedJson& room);
/// Why it cannot be felt, and what would allow it; empty: it can.
[[nodiscard]] std::string roomWarning(const OrderedJson& room);

}  // namespace palpate::cli
