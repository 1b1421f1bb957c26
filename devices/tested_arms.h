/// Which arms have passed `palpate devices --test`, and what was measured: a file of the user's.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/devices/arm.h"
#include "palpate/devices/self_test.h"

namespace palpate {

/// Where `palpate devices --test` keeps what it found: $XDG_STATE_HOME/palpate/arms.json or
/// ~/.local/state/palpate/arms.json.
[[nodiscard]] std::filesystem::path testedArmsFile();
/// True where this arm has passed as it is described now, its scale measured along every axis. One
/// that has nothing of its own never has.
[[nodiscard]] bool isTested(const ArmIdentity& arm);
/// What was measured then; zeros where it is not tested. What is uncertain is taken from it.
[[nodiscard]] MeasuredArm measuredArm(const ArmIdentity& arm);
/// ArmIdentity::own of those of this name and fingerprint that have passed.
[[nodiscard]] std::vector<std::string> testedArms(const ArmIdentity& like);
/// Remembers that it has, and what was measured. Throws DeviceError where it cannot be written.
///
/// @pre result.scale is measured along every axis that it moves along.
void rememberTest(const ArmIdentity& arm, const SelfTestResult& result);
/// It has failed: it is not tested any more. Throws DeviceError where that cannot be written.
void forgetTest(const ArmIdentity& arm);

}  // namespace palpate
