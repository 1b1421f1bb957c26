/// The user's file of arms that have passed `palpate devices --test`, with their measurements.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "palpate/devices/arm/arm.h"
#include "palpate/devices/arm/self_test.h"

namespace palpate {

/// Returns the file in which `palpate devices --test` keeps its results:
/// $XDG_STATE_HOME/palpate/arms.json or ~/.local/state/palpate/arms.json.
[[nodiscard]] std::filesystem::path testedArmsFile();
/// Returns true if this arm has passed its test with its present description and with its scale
/// measured along every axis. An arm without ArmIdentity::own never counts as tested.
[[nodiscard]] bool isTested(const ArmIdentity& arm);
/// Returns the test's measurements, with friction reduced by its uncertainty. Returns zeros if the
/// arm is not tested or its record is incomplete.
[[nodiscard]] MeasuredArm measuredArm(const ArmIdentity& arm);
/// Returns ArmIdentity::own of all tested arms with the name and fingerprint of `like`.
[[nodiscard]] std::vector<std::string> testedArms(const ArmIdentity& like);
/// Stores a passed test with its measurements. Throws DeviceError if it cannot write the file.
///
/// @pre result.scale is measured along every axis along which the arm moves.
void rememberTest(const ArmIdentity& arm, const SelfTestResult& result);
/// Removes the arm from the tested arms. Throws DeviceError if it cannot write the file.
void forgetTest(const ArmIdentity& arm);

}  // namespace palpate
