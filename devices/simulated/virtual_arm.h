/// A simulated arm without a hand: a user can try the self-test without hardware.
#pragma once

#include <memory>

#include "palpate/devices/arm/arm.h"

namespace palpate {

/// Returns a SimulatedDevice with the interface of an arm. Each write advances its time by 1 ms.
/// No hand holds the arm, and the arm has no weight: only a force moves it.
[[nodiscard]] std::unique_ptr<Arm> makeVirtualArm();

}  // namespace palpate
