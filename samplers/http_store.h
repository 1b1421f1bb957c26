/// Objects from a web server: nginx, Apache, Ceph's gateway, anything that gives files by HTTP.
#pragma once

#include <memory>
#include <string>

#include "palpate/samplers/far_bricks.h"

namespace palpate {

/// The folder at an address, http://host[:port]/folder or https://..., by libcurl. Throws
/// VolumeError: it is no address, as one with a user or a question is none.
///
/// It takes GET alone, follows no redirection, keeps no cookie, and reads no password file.
[[nodiscard]] std::unique_ptr<ObjectStore> makeHttpStore(const std::string& address,
                                                         const StoreParams& params = {});

}  // namespace palpate
