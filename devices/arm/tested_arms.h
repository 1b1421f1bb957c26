/// Reads and writes the user's file of arms that have passed `palpate devices --test`, with their
/// measurements.
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
/// Returns true if this arm has passed with its present description and with its scale measured
/// along every axis. An arm without an identity of its own (ArmIdentity::own) never counts as
/// tested.
[[nodiscard]] bool isTested(const ArmIdentity& arm);
/// Returns the measurements of the arm's test; zeros if the arm is not tested. The friction is
/// reduced by its uncertainty.
[[nodiscard]] MeasuredArm measuredArm(const ArmIdentity& arm);
/// Returns ArmIdentity::own of all arms that have passed and have the name and fingerprint of
/// `like`.
[[nodiscard]] std::vector<std::string> testedArms(const ArmIdentity& like);
/// Stores that the arm has passed, with its measurements. Throws DeviceError if the file cannot be
/// written.
///
/// @pre result.scale is measured along every axis along which the arm moves.
void rememberTest(const ArmIdentity& arm, const SelfTestResult& result);
/// Records that the arm has failed, so that it no longer counts as tested. Throws DeviceError if
/// the file cannot be written.
void forgetTest(const ArmIdentity& arm);

}  // namespace palpate
