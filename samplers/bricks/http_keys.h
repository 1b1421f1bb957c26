/// Private to the module palpate_http.so: names, passwords and tokens for web servers.
#pragma once

#include <optional>
#include <string>

namespace palpate {

/// Scheme, host and port of an address, as libcurl returns them.
struct HttpOrigin {
  std::string scheme;  ///< "http" or "https".
  std::string host;    ///< Host name or IP address, in lower case.
  std::string port;    ///< Port; the scheme's default if the address has none.

  /// Returns true if scheme, host and port are equal.
  [[nodiscard]] bool operator==(const HttpOrigin&) const = default;
};
/// Returns the origin of an address. Returns no value if the address is invalid, contains a user,
/// or has another scheme than http and https.
[[nodiscard]] std::optional<HttpOrigin> httpOriginOf(const std::string& address);

/// The secret for a server: a token, or a name and a password if the token is empty.
struct HttpKey {
  std::string name;      ///< User of HTTP's basic method.
  std::string password;  ///< Password of the user; may contain spaces.
  std::string token;     ///< Bearer token.
};

/// Returns the key for a server, from the file that the environment variable PALPATE_HTTP_KEYS
/// names. Returns no value if the variable is not set, or if the file has no line for the server.
///
/// A line is `ADDRESS basic NAME PASSWORD` or `ADDRESS bearer TOKEN`. ADDRESS is that of the
/// server, such as https://server:8443. A password may contain spaces. Empty lines and lines that
/// begin with # are skipped. Throws VolumeError, without any text of the file, in these cases: the
/// file cannot be read or has more than 64 kB; another user owns it or has permissions for it; a
/// line is invalid; two lines are for one server; a key would be sent over http to another machine.
/// It checks the lines of all servers.
[[nodiscard]] std::optional<HttpKey> findHttpKey(const HttpOrigin& origin);

}  // namespace palpate
