/// Objects from a web server: nginx, Apache, Ceph's gateway, or any other file server by HTTP.
#pragma once

#include <memory>
#include <string>

#include "palpate/samplers/bricks/far_bricks.h"

namespace palpate {

/// Makes a store of the folder at an address, http://host[:port]/folder or https://..., by libcurl.
/// Throws VolumeError if the address is invalid, for example has a user or a query.
///
/// The store sends only GET, follows no redirection, keeps no cookie, and reads no password file.
[[nodiscard]] std::unique_ptr<ObjectStore> makeHttpStore(const std::string& address,
                                                         const StoreParams& params = {});

}  // namespace palpate
