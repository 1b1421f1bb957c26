/// Private to devices: the description of a device in the header of a recording.
#pragma once

#include <nlohmann/json.hpp>

#include "palpate/engine/safety/device.h"

namespace palpate {

/// Writes the description of a device, with its limits.
[[nodiscard]] nlohmann::ordered_json deviceToJson(const DeviceInfo& device);
/// Reads a description. Throws nlohmann::json::exception if a key is missing or has another type.
[[nodiscard]] DeviceInfo deviceFromJson(const nlohmann::ordered_json& json);

}  // namespace palpate
