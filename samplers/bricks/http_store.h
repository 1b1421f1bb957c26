/// Objects from a web server: nginx, Apache, Ceph's gateway, or any other file server by HTTP.
#pragma once

#include <memory>
#include <string>

#include "palpate/samplers/bricks/far_bricks.h"

namespace palpate {

/// Makes a store of the folder at http://host[:port]/folder or https://..., through libcurl. The
/// first call loads the module palpate_http.so. Throws VolumeError if the module is missing, or if
/// the file of keys or the address is invalid. An address with @, ? or # is invalid.
///
/// The store sends only GET requests, and stores no cookies. It follows one redirection of a
/// request, to the same host, but not from https to http. If PALPATE_HTTP_KEYS names a file with a
/// key for the server, the store sends the key (http_keys.h).
[[nodiscard]] std::unique_ptr<ObjectStore> makeHttpStore(const std::string& address,
                                                         const StoreParams& params = {});
/// Type of the function that the module palpate_http.so exports and makeHttpStore() calls.
using HttpFactory = std::unique_ptr<ObjectStore>(const std::string& address,
                                                 const StoreParams& params);

}  // namespace palpate
