/// Private to devices: what the parts of an arm's profile say of each other.
#pragma once

#include "palpate/devices/profile_table.h"

namespace palpate {

/// Finds the fields that are named, and checks that numbers fit together: in other units than they
/// are meant they do not. Throws as `root` does, with the path of what is wrong.
///
/// @param root  The file that `file` was read from.
[[nodiscard]] HidProfile checkedProfile(ProfileFile file, const JsonNode& root);

}  // namespace palpate
