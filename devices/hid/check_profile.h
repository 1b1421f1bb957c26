/// Private to devices: checks that the parts of an arm's profile agree.
#pragma once

#include "palpate/devices/hid/profile_table.h"

namespace palpate {

/// Returns the profile with its field names resolved. Checks that its numbers are consistent, to
/// detect wrong units. Throws the error of `root`, which names the path of the wrong entry.
///
/// @param root  JSON of the file from which `file` was read.
[[nodiscard]] HidProfile checkedProfile(ProfileFile file, const JsonNode& root);

}  // namespace palpate
