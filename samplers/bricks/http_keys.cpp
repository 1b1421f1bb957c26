#include "palpate/samplers/bricks/http_keys.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <curl/curl.h>
#include <fcntl.h>
#include <memory>
#include <sstream>
#include <sys/stat.h>
#include <unistd.h>
#include <utility>
#include <vector>

#include "palpate/engine/error.h"
#include "palpate/samplers/descriptor.h"

namespace palpate {
namespace {

constexpr const char* kVariable = "PALPATE_HTTP_KEYS";
/// Longest file of keys [bytes].
constexpr std::size_t kLongest = 1U << 16U;

[[noreturn]] void refuse(const std::string& file, const std::string& why,
                         const std::string& remedy) {
  throw VolumeError(file, why, remedy);
}

/// Returns the content of a file. Throws VolumeError if the file cannot be read, is not a regular
/// file or is longer than kLongest, or if this user is not its owner or other users have
/// permissions for it.
std::string readSecret(const std::string& file) {
  const Descriptor descriptor(open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (descriptor.get() < 0) {
    refuse(file, std::string("it cannot be read (") + std::strerror(errno) + ")",
           std::string("correct the path in ") + kVariable +
               ", or become the file's owner (chown) and run chmod 600 on it");
  }
  struct stat about {};
  if (fstat(descriptor.get(), &about) != 0 || !S_ISREG(about.st_mode)) {
    refuse(file, "it is not a file", std::string("correct the path in ") + kVariable);
  }
  constexpr unsigned kOthers = S_IRWXG | S_IRWXO;
  if (about.st_uid != geteuid() || (about.st_mode & kOthers) != 0) {
    refuse(file, "another user owns it, or other users have permissions for it",
           "become its owner (chown), and run chmod 600 on it");
  }
  std::string text(kLongest + 1, '\0');
  std::size_t size = 0;
  while (size < text.size()) {
    const ssize_t got = read(descriptor.get(), text.data() + size, text.size() - size);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) {
      refuse(file, std::string("it cannot be read (") + std::strerror(errno) + ")",
             "check the disk");
    }
    if (got == 0) break;
    size += static_cast<std::size_t>(got);
  }
  if (size > kLongest) refuse(file, "it has more than 64 kB", "remove lines that are not needed");
  text.resize(size);
  return text;
}

/// Returns the text up to the next space, and removes both from `line`.
std::string takeWord(std::string& line) {
  const std::size_t end = std::min(line.find(' '), line.size());
  std::string word = line.substr(0, end);
  line.erase(0, std::min(end + 1, line.size()));
  return word;
}

/// Reads the part of a line after the address. Returns no value if this part is invalid.
std::optional<HttpKey> keyOf(std::string rest) {
  const auto controls = [](unsigned char c) { return c < ' ' || c == 127; };
  if (std::any_of(rest.begin(), rest.end(), controls)) return std::nullopt;
  const std::string kind = takeWord(rest);
  HttpKey key;
  if (kind == "bearer") {
    key.token = rest;
    if (key.token.empty() || key.token.find(' ') != std::string::npos) return std::nullopt;
    return key;
  }
  key.name = takeWord(rest);
  key.password = rest;
  // In HTTP's basic method, a colon ends the name.
  const bool valid = kind == "basic" && !key.name.empty() && !key.password.empty() &&
                     key.name.find(':') == std::string::npos;
  return valid ? std::optional(key) : std::nullopt;
}

bool isThisMachine(const HttpOrigin& origin) {
  constexpr std::array kHosts{"127.0.0.1", "localhost", "[::1]"};
  return std::find(kHosts.begin(), kHosts.end(), origin.host) != kHosts.end();
}

}  // namespace

std::optional<HttpOrigin> httpOriginOf(const std::string& address) {
  const std::unique_ptr<CURLU, decltype(&curl_url_cleanup)> url(curl_url(), &curl_url_cleanup);
  if (!url || curl_url_set(url.get(), CURLUPART_URL, address.c_str(), CURLU_DISALLOW_USER) != 0) {
    return std::nullopt;
  }
  HttpOrigin origin;
  for (const auto& [part, to] : {std::pair{CURLUPART_SCHEME, &origin.scheme},
                                 {CURLUPART_HOST, &origin.host},
                                 {CURLUPART_PORT, &origin.port}}) {
    char* text = nullptr;
    if (curl_url_get(url.get(), part, &text, CURLU_DEFAULT_PORT) != 0) return std::nullopt;
    const std::unique_ptr<char, decltype(&curl_free)> owner(text, &curl_free);
    *to = text;
  }
  std::transform(origin.host.begin(), origin.host.end(), origin.host.begin(), [](char c) {
    return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  });
  if (origin.scheme != "http" && origin.scheme != "https") return std::nullopt;
  return origin;
}

std::optional<HttpKey> findHttpKey(const HttpOrigin& origin) {
  const char* const file = std::getenv(kVariable);
  if (file == nullptr || *file == '\0') return std::nullopt;
  std::istringstream lines(readSecret(file));
  std::optional<HttpKey> found;
  std::vector<std::pair<HttpOrigin, int>> earlier;
  std::string line;
  for (int number = 1; std::getline(lines, line); ++number) {
    if (line.empty() || line.front() == '#') continue;
    const std::optional<HttpOrigin> to = httpOriginOf(takeWord(line));
    const std::optional<HttpKey> key = keyOf(std::move(line));
    const std::string which = "line " + std::to_string(number);
    if (!to || !key) {
      refuse(file, which + " is not a server's address followed by a key",
             "write https://HOST basic NAME PASSWORD, or https://HOST bearer TOKEN, with single "
             "spaces and Unix line ends");
    }
    for (const auto& [other, its_number] : earlier) {
      if (*to != other) continue;
      refuse(file, which + " has another key for the server of line " + std::to_string(its_number),
             "remove one of these lines");
    }
    earlier.emplace_back(*to, number);
    if (*to == origin) found = key;
    if (to->scheme == "http" && !isThisMachine(*to)) {
      refuse(file, which + " has a key for http, which does not encrypt it", "use https");
    }
  }
  return found;
}

}  // namespace palpate
