/// Private to devices: checks that the numbers of an arm's profile agree. Each check throws as its
/// node does, with the path of the wrong entry.
#pragma once

#include <cstddef>

#include "palpate/devices/hid/hid_profile.h"
#include "palpate/devices/json/json_node.h"

namespace palpate {

/// Smallest share of a motor's limit that the profile's largest force must use. A smaller share
/// indicates a wrong unit.
inline constexpr double kLeastAsked = 1e-3;

/// True if a joint's motor is driven by the output field of this index.
[[nodiscard]] bool isMotor(const HidProfile& profile, std::size_t field);

/// Checks that an output and its rate are given together, and the rate's range.
void checkRates(const JsonNode& root, const HidProfile& profile, bool drives);

/// Checks that no counter of reports shares bits with a joint or a flag. These do not change with
/// every report, so new reports of a still arm would count as old.
void checkSequences(const JsonNode& input, const HidProfile& profile);

/// Checks the parts of the profile against each other: closing time, limits, homing, motors,
/// output fields and the arm's physical numbers.
void checkTogether(const JsonNode& root, const HidProfile& profile);

/// Checks that the paths in "sources" exist.
void checkSources(const JsonNode& root, const HidProfile& profile);

}  // namespace palpate
