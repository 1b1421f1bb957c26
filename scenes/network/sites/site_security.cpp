#include "palpate/scenes/network/sites/site_security.h"

#include <array>
#include <dlfcn.h>
#include <string>
#include <system_error>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

namespace fs = std::filesystem;

/// Returns the path of a DDS security plug-in: in the DDS library's folder or, on Debian, below it.
std::string pluginOf(const char* what) {
  Dl_info info{};
  const std::string name = fmt::format("libdds_security_{}.so", what);
  if (dladdr(reinterpret_cast<const void*>(&dds_create_participant), &info) != 0) {
    const fs::path beside = fs::path(info.dli_fname).parent_path();
    for (const fs::path& folder : {beside, beside / "libddsc0debian"}) {
      std::error_code ignored;
      if (fs::exists(folder / name, ignored)) return (folder / name).string();
    }
  }
  throw Error(
      "--site-keys",
      fmt::format("the installed Cyclone DDS lacks DDS security: {} is missing", name),
      "install the DDS of Debian 12, or leave out --site-keys and connect the machines by a "
      "tunnel (docs/sites.md)");
}

}  // namespace

void secure(dds_qos_t* participant, const fs::path& keys) {
  struct Plugin {
    const char* library;
    const char* property;
    const char* function;
  };
  for (const auto& [library, property, function] :
       {Plugin{"auth", "auth", "authentication"}, Plugin{"ac", "access", "access_control"},
        Plugin{"crypto", "crypto", "crypto"}}) {
    const std::string begin = fmt::format("dds.sec.{}.library.", property);
    dds_qset_prop(participant, (begin + "path").c_str(), pluginOf(library).c_str());
    dds_qset_prop(participant, (begin + "init").c_str(), fmt::format("init_{}", function).c_str());
    dds_qset_prop(participant, (begin + "finalize").c_str(),
                  fmt::format("finalize_{}", function).c_str());
  }
  constexpr std::array<std::array<const char*, 2>, 6> kFiles{{
      {"auth.identity_ca", "identity_ca.cert.pem"},
      {"auth.identity_certificate", "cert.pem"},
      {"auth.private_key", "key.pem"},
      {"access.permissions_ca", "permissions_ca.cert.pem"},
      {"access.governance", "governance.p7s"},
      {"access.permissions", "permissions.p7s"},
  }};
  for (const auto& [property, file] : kFiles) {
    const fs::path path = fs::absolute(keys / file);
    std::error_code error;
    const fs::file_status status = fs::status(path, error);
    if (error && status.type() != fs::file_type::not_found) {
      throw Error("--site-keys",
                  fmt::format("{} cannot be read ({})", path.string(), error.message()),
                  "check the permissions of its folder");
    }
    if (!fs::is_regular_file(status)) {
      throw Error("--site-keys", fmt::format("{} is missing or not a file", path.string()),
                  "make keys with site_keys.sh (docs/sites.md)");
    }
    dds_qset_prop(participant, fmt::format("dds.sec.{}", property).c_str(),
                  ("file:" + path.string()).c_str());
  }
}

}  // namespace palpate
