/// Private to scenes/site: DDS's own security.
#pragma once

#include <dds/dds.h>
#include <filesystem>

namespace palpate {

/// Has a participant take part by keys alone: it meets no one without, and tells nobody else a
/// word. `keys` has the six files of an enclave of ROS 2's, as site_keys.sh makes them. Throws
/// Error: one is missing, this DDS has no security.
void secure(dds_qos_t* participant, const std::filesystem::path& keys);

}  // namespace palpate
