#include "palpate/samplers/module.h"

#include <algorithm>
#include <cstdlib>
#include <dlfcn.h>
#include <filesystem>
#include <link.h>
#include <string_view>
#include <sys/auxv.h>
#include <system_error>
#include <vector>

#include "palpate/engine/error.h"

namespace palpate {
namespace {

namespace fs = std::filesystem;

fs::path ownFolder() {
  Dl_info info{};
  link_map* map = nullptr;
  const bool known = dladdr1(reinterpret_cast<const void*>(&ownFolder), &info,
                             reinterpret_cast<void**>(&map), RTLD_DL_LINKMAP) != 0;
  // The link map has no name for the program itself.
  const bool is_library = known && map->l_name[0] != '\0';
  std::error_code ignored;
  return fs::canonical(is_library ? map->l_name : "/proc/self/exe", ignored).parent_path();
}

std::vector<fs::path> moduleFolders() {
  std::vector<fs::path> folders;
  if (getauxval(AT_SECURE) == 0) {
    const char* given = std::getenv("PALPATE_MODULES");
    if (given != nullptr && given[0] == '/') return {given};
    const fs::path own = ownFolder();
    std::error_code ignored;
    const fs::path beside = own.parent_path() / "lib/palpate";
    if (!own.empty() && fs::is_directory(beside, ignored)) return {beside};
    // The Python module and libpalpate_c may be several folders below lib.
    for (fs::path above = own; above.has_relative_path(); above = above.parent_path()) {
      if (above.filename() != "lib") continue;
      folders.push_back(above / "palpate");
      break;
    }
  }
  // A program that links palpate's libraries may be in a folder of its own.
  for (const char* folder : {"/usr/local/lib/palpate", "/usr/lib/palpate"}) {
    if (std::find(folders.begin(), folders.end(), folder) == folders.end()) {
      folders.emplace_back(folder);
    }
  }
  return folders;
}

}  // namespace

const ModuleVersion& loadModule(const Module& module, const std::string& subject) {
  const std::string remedy =
      std::string("install the package palpate-network, or build palpate with ") + module.needed;
  std::string searched;
  std::string other;  // describes a module of another release
  for (const fs::path& folder : moduleFolders()) {
    const fs::path file = folder / module.file;
    std::error_code ignored;
    if (!fs::exists(file, ignored)) {
      searched += (searched.empty() ? "" : ", ") + folder.string();
      continue;
    }
    void* const library = dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (library == nullptr) {
      throw Error(subject, dlerror(),
                  "install the library that is missing, or install palpate-network again");
    }
    const auto* const entry = static_cast<const ModuleVersion*>(dlsym(library, "palpate_module"));
    if (entry != nullptr && entry->version == std::string_view(kVersion)) return *entry;
    other = file.string() + " belongs to " +
            (entry != nullptr ? std::string("palpate ") + entry->version : "another release") +
            ", and this is palpate " + kVersion;
  }
  if (!other.empty()) {
    throw Error(subject, other, "install palpate and palpate-network of the same release");
  }
  // If the user names a folder, only that folder is searched.
  const char* const given = std::getenv("PALPATE_MODULES");
  const bool elsewhere = given != nullptr && searched == given;
  throw Error(subject, std::string(module.file) + " is missing in " + searched,
              remedy + (elsewhere ? ", or unset PALPATE_MODULES" : ""));
}

}  // namespace palpate
