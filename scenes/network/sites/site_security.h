/// Private to scenes/network/sites: the security of DDS.
#pragma once

#include <dds/dds.h>
#include <filesystem>

namespace palpate {

/// Lets a participant accept only peers with keys of the same authority. `keys` has the six files
/// of a ROS 2 enclave, as site_keys.sh makes them. Throws Error if a file is missing or not
/// accessible, or if this DDS lacks security.
void secure(dds_qos_t* participant, const std::filesystem::path& keys);

}  // namespace palpate
