/// What a coupling has room for on an arm, by three numbers (devices/stability.h).
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
/// Does it swing up even in a relaxed hand? Of JSON that is not null, as below.
[[nodiscard]] bool swingsUp(const OrderedJson& room);
/// What to use it for, or instead of it: a sentence without its end.
[[nodiscard]] std::string roomWords(const OrderedJson& room);
/// How that is known: all three limits.
[[nodiscard]] std::string roomNumbers(const OrderedJson& room);
/// The lines of a report whose words begin at `column`; of null none. The numbers only if verbose.
void sayRoom(const OrderedJson& room, int column, bool verbose);

}  // namespace palpate::cli
