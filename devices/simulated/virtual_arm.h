/// A simulated arm without a hand: a user can try the self-test without hardware.
#pragma once

#include <memory>

#include "palpate/devices/arm/arm.h"

namespace palpate {

/// Returns a SimulatedDevice with the interface of an arm. Each write advances its time by 1 ms.
/// No hand holds it, and it has no weight: it moves only while a force pushes it.
[[nodiscard]] std::unique_ptr<Arm> makeVirtualArm();

}  // namespace palpate
