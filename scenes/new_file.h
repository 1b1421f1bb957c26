/// Output files that are nobody else's.
#pragma once

#include <fcntl.h>
#include <filesystem>
#include <random>
#include <string>
#include <unistd.h>

namespace palpate {

/// A name beside `file` that nobody knows before, for what is renamed to it when all is well.
[[nodiscard]] inline std::filesystem::path partialOf(const std::filesystem::path& file) {
  std::random_device random;
  std::filesystem::path partial = file;
  partial += ".partial-" + std::to_string(getpid()) + "-" + std::to_string(random());
  return partial;
}

/// Creates a file of that name to write to. A file or a link that is there already is not opened:
/// who may write in the folder could have put it there, for another's file to be overwritten.
///
/// @return  Its descriptor; -1 with errno where there is something, or none can be made.
[[nodiscard]] inline int createNewFile(const std::filesystem::path& path) noexcept {
  return ::open(path.c_str(), O_RDWR | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666);
}

/// The name of an open file for libraries of this process that open by name: the same file,
/// whatever became of the name under which it was created. Where the kernel does not let it be
/// opened so, as in a program with capabilities of its own, that name.
[[nodiscard]] inline std::filesystem::path nameOfOpen(int descriptor,
                                                      const std::filesystem::path& created) {
  const std::filesystem::path open = "/proc/self/fd/" + std::to_string(descriptor);
  return ::access(open.c_str(), R_OK | W_OK) == 0 ? open : created;
}

}  // namespace palpate
