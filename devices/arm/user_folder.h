/// Private to devices: the user's folders.
#pragma once

#include <cstdlib>
#include <filesystem>

namespace palpate {

/// Returns a folder of the user by the XDG Base Directory Specification: the value of the variable
/// `name`, or else `otherwise` below $HOME (below / without it). A relative path is invalid there,
/// so it is ignored.
[[nodiscard]] inline std::filesystem::path userFolder(const char* name, const char* otherwise) {
  const char* folder = std::getenv(name);
  if (folder != nullptr && *folder == '/') return folder;
  const char* home = std::getenv("HOME");
  return std::filesystem::path(home != nullptr && *home == '/' ? home : "/") / otherwise;
}

}  // namespace palpate
