/// Private to devices: the user's folders.
#pragma once

#include <cstdlib>
#include <filesystem>

namespace palpate {

/// Returns a folder of the user by the XDG Base Directory Specification: the value of the variable
/// `name`, or else `otherwise` below $HOME, or below / without a home. A variable with a relative
/// path is ignored, because the specification makes such a path invalid.
[[nodiscard]] inline std::filesystem::path userFolder(const char* name, const char* otherwise) {
  const char* folder = std::getenv(name);
  if (folder != nullptr && *folder == '/') return folder;
  const char* home = std::getenv("HOME");
  return std::filesystem::path(home != nullptr && *home == '/' ? home : "/") / otherwise;
}

}  // namespace palpate
