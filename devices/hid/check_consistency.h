/// Private to devices: checks that the numbers of an arm's profile agree. Each check throws the
/// error of its JSON node, which names the path of the wrong entry.
#pragma once

#include <cstddef>

#include "palpate/devices/hid/hid_profile.h"
#include "palpate/devices/json/json_node.h"

namespace palpate {

/// Smallest share of a motor's limit that the profile's largest force must use. A smaller share
/// shows a wrong unit.
inline constexpr double kLeastAsked = 1e-3;

/// Returns true if the output field with this index drives a joint's motor.
[[nodiscard]] bool isMotor(const HidProfile& profile, std::size_t field);

/// Checks that the profile gives an output and its rate together, and that the rate is in range.
void checkRates(const JsonNode& root, const HidProfile& profile, bool drives);

/// Checks that no report counter shares bits with a joint or a flag. Joints and flags of a still
/// arm do not change from report to report, so its new reports would count as repetitions.
void checkSequences(const JsonNode& input, const HidProfile& profile);

/// Checks the parts of the profile against each other: closing time, limits, homing, motors,
/// output fields and the arm's physical numbers.
void checkTogether(const JsonNode& root, const HidProfile& profile);

/// Checks that the paths in "sources" exist.
void checkSources(const JsonNode& root, const HidProfile& profile);

}  // namespace palpate
