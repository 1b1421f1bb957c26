#include <algorithm>
#include <arpa/inet.h>
#include <array>
#include <charconv>
#include <netinet/in.h>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/network/sites/site.h"

namespace palpate {
namespace {

constexpr std::size_t kLongestName = 31;
constexpr int kMostDomain = 230;

bool isNumeric(const std::string& address) {
  std::array<unsigned char, sizeof(in6_addr)> bytes{};
  return inet_pton(AF_INET, address.c_str(), bytes.data()) == 1 ||
         inet_pton(AF_INET6, address.c_str(), bytes.data()) == 1;
}

}  // namespace

bool isSiteName(const std::string& name) noexcept {
  const auto is_fit = [](unsigned char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' ||
           c == '_';
  };
  return !name.empty() && name.size() <= kLongestName &&
         std::all_of(name.begin(), name.end(), is_fit);
}

SiteParams siteFrom(const std::string& words, const std::vector<std::string>& with) {
  SiteParams params;
  const std::size_t at = words.find('@');
  params.name = words.substr(0, at);
  if (!isSiteName(params.name)) {
    throw Error("--site", fmt::format("\"{}\" is not a valid name of a site", params.name),
                "give up to 31 letters, digits, - and _");
  }
  if (at != std::string::npos) {
    const char* end = words.data() + words.size();
    const auto read = std::from_chars(words.data() + at + 1, end, params.domain);
    if (read.ec != std::errc() || read.ptr != end || params.domain < 0 ||
        params.domain > kMostDomain) {
      throw Error("--site", fmt::format("\"{}\" is not a domain", words.substr(at + 1)),
                  fmt::format("give NAME@N with N from 0 to {}", kMostDomain));
    }
  }
  params.with = with;
  for (const std::string& address : with) {
    // Rejects host names, and text that would change the DDS configuration (XML).
    if (isNumeric(address)) continue;
    throw Error("--with", fmt::format("\"{}\" is not a numeric address", address),
                "give an address such as 10.0.0.2");
  }
  return params;
}

}  // namespace palpate
