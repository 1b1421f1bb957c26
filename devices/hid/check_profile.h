/// Private to devices: checks that the parts of an arm's profile agree.
#pragma once

#include "palpate/devices/hid/profile_table.h"

namespace palpate {

/// Resolves field names and checks that the numbers are consistent, which detects wrong units.
/// Throws as `root` does, with the path of the wrong entry.
///
/// @param root  The file that `file` was read from.
[[nodiscard]] HidProfile checkedProfile(ProfileFile file, const JsonNode& root);

}  // namespace palpate
