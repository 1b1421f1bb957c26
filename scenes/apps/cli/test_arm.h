/// The self-test of an arm by `palpate devices --test`.
#pragma once

#include "palpate/devices/arm/self_test.h"
#include "palpate/scenes/apps/cli/devices.h"
#include "palpate/scenes/apps/common/common.h"

namespace palpate::cli {

inline constexpr const char* kNoMotor = "no motor along this axis, and no force";

[[nodiscard]] OrderedJson axisNames(const ArmAxes& axes);

/// Tests the arm `options.test`. Stores that a real arm has passed, if its scale was measured and
/// its identity is known. Returns the exit status. Throws Error.
[[nodiscard]] int testArm(const DevicesOptions& options);

}  // namespace palpate::cli
