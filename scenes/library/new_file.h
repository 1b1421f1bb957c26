/// Creates output files, safe from other users of the folder.
#pragma once

#include <cstddef>
#include <fcntl.h>
#include <filesystem>
#include <random>
#include <string>
#include <unistd.h>

namespace palpate {

/// The name of a partial file is the name of the file, this text, and digits.
inline constexpr const char* kPartialMark = ".partial-";

/// Returns an unpredictable path in the folder of `file`. The caller writes the output there, and
/// then renames it to `file`.
[[nodiscard]] inline std::filesystem::path partialOf(const std::filesystem::path& file) {
  std::random_device random;
  std::filesystem::path partial = file;
  partial += kPartialMark + std::to_string(getpid()) + "-" + std::to_string(random());
  return partial;
}

/// Returns the path for which partialOf() has made `partial`, for messages; other paths unchanged.
[[nodiscard]] inline std::filesystem::path wholeOf(const std::filesystem::path& partial) {
  const std::string text = partial.string();
  const std::size_t at = text.rfind(kPartialMark);
  if (at == std::string::npos) return partial;
  const std::size_t end = at + std::string(kPartialMark).size();
  if (text.find_first_not_of("0123456789-", end) != std::string::npos) return partial;
  return text.substr(0, at);
}

/// Creates and opens a file. Returns the descriptor, or -1 and sets errno. Never opens an existing
/// file or a link, because another user of the folder could have made it.
[[nodiscard]] inline int createNewFile(const std::filesystem::path& path) noexcept {
  return ::open(path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666);
}

/// Returns the path of an open file in /proc, for libraries that open files by name. The path leads
/// to the open file even if another file now has the name `created`. If the kernel denies access to
/// this path, as in a program with file capabilities, returns `created`.
[[nodiscard]] inline std::filesystem::path nameOfOpen(int descriptor,
                                                      const std::filesystem::path& created) {
  const std::filesystem::path open = "/proc/self/fd/" + std::to_string(descriptor);
  return ::access(open.c_str(), R_OK | W_OK) == 0 ? open : created;
}

}  // namespace palpate
