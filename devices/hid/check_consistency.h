/// Private to devices: checks that the numbers of an arm's profile agree.
#pragma once

#include <cstddef>

#include "palpate/devices/hid/hid_profile.h"
#include "palpate/devices/json/json_node.h"

namespace palpate {

/// Smallest accepted share of a motor's limit that the largest force uses. If all motors use less,
/// a number has a wrong unit. For a PID device, each axis must use at least this share.
inline constexpr double kLeastAsked = 1e-3;

[[nodiscard]] bool isMotor(const HidProfile& profile, std::size_t field);

void checkRates(const JsonNode& root, const HidProfile& profile, bool drives);

/// Checks that no report counter shares bits with a joint or a flag. These bits do not change while
/// the arm rests, so its new reports would count as repetitions.
void checkSequences(const JsonNode& input, const HidProfile& profile);

/// Checks closing time, limits, homing, motors, gravity, firmware, output fields and physical
/// numbers.
void checkTogether(const JsonNode& root, const HidProfile& profile);

void checkSources(const JsonNode& root, const HidProfile& profile);

}  // namespace palpate
