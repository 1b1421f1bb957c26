#include "palpate/samplers/leased_file.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <fstream>
#include <string>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/descriptor.h"

namespace palpate {
namespace {

/// Returns true if the system grants a read lease. Then programs that want to write must wait.
bool lease(int file) {
  // Selects SIGURG, which is ignored by default. The default signal, SIGIO, would end this program.
  if (fcntl(file, F_SETSIG, SIGURG) != 0 || fcntl(file, F_SETLEASE, F_RDLCK) != 0) return false;
  (void)fcntl(file, F_SETOWN, 0);
  return true;
}

LeasedFile::Clock::duration longestWait() {
  double seconds = 45.0;
  std::ifstream("/proc/sys/fs/lease-break-time") >> seconds;
  // If the limit is 0, other programs wait until the lease ends.
  if (!(seconds > 0.0)) return LeasedFile::Clock::duration::max() / 4;
  return std::chrono::duration_cast<LeasedFile::Clock::duration>(
      std::chrono::duration<double>(seconds));
}

/// Opens a temporary file that has no name in the file system. Returns -1 if this fails.
int nameless(const std::filesystem::path& folder) {
  const int file = open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, S_IRUSR | S_IWUSR);
  if (file >= 0) return file;
  std::string name = (folder / "palpate-XXXXXX").string();
  const int named = mkostemp(name.data(), O_CLOEXEC);
  if (named >= 0) unlink(name.c_str());
  return named;
}

int copyAll(int from, int to) {
  if (to < 0 || lseek(from, 0, SEEK_SET) < 0) return errno;
  constexpr std::size_t kPiece = std::size_t{1} << 30U;
  for (bool by_system = true;;) {
    if (by_system) {
      const ssize_t moved = copy_file_range(from, nullptr, to, nullptr, kPiece, 0);
      if (moved > 0) continue;
      if (moved == 0 && lseek(from, 0, SEEK_CUR) > 0) return 0;
      if (moved < 0 && errno == EINTR) continue;
      // If copy_file_range() does not support the file systems, or if the file states a size of 0,
      // the loop continues with read() and write().
      if (moved < 0 && (errno == ENOSPC || errno == EIO)) return errno;
      by_system = false;
    }
    static thread_local std::array<char, 1U << 16U> piece;
    const ssize_t got = read(from, piece.data(), piece.size());
    if (got == 0) return 0;
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return errno;
    for (ssize_t done = 0; done < got;) {
      const ssize_t put = write(to, piece.data() + done, static_cast<std::size_t>(got - done));
      if (put < 0 && errno != EINTR) return errno;
      done += std::max<ssize_t>(put, 0);
    }
  }
}

/// Returns the descriptor of a private copy, in the folder for temporary files or in memory.
int copyOf(int file, const std::filesystem::path& path) {
  std::error_code error;
  const std::filesystem::path folder = std::filesystem::temp_directory_path(error);
  if (!error) {
    Descriptor copy(nameless(folder));
    if (copyAll(file, copy.get()) == 0) return copy.release();
  }
  Descriptor copy(memfd_create("palpate", MFD_CLOEXEC));
  const int trouble = copyAll(file, copy.get());
  if (trouble == 0) return copy.release();
  throw VolumeError(
      path.string(),
      std::string("another program may change it during the load, and it cannot be copied (") +
          std::strerror(trouble) + ")",
      trouble == EIO     ? "check the disk"
      : trouble == EFBIG ? "raise the limit of file sizes (ulimit -f)"
                         : "free disk space for temporary files, or set TMPDIR to another folder");
}

}  // namespace

void throwAbsent(const std::filesystem::path& path, const std::string& what,
                 const std::error_code& error) {
  if (error == std::errc::no_such_file_or_directory || error == std::errc::not_a_directory) {
    throw VolumeError(path.string(), what, "check the path");
  }
  throw VolumeError(path.string(), "it cannot be read (" + error.message() + ")",
                    "check the path and its permissions");
}

LeasedFile::LeasedFile(const std::filesystem::path& path) {
  Descriptor file(open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (file.get() < 0) {
    throw VolumeError(path.string(),
                      std::string("it cannot be read (") + std::strerror(errno) + ")",
                      "check the file, its permissions and the limit of open files (ulimit -n)");
  }
  leased_ = lease(file.get());
  file_ = leased_ ? file.release() : copyOf(file.get(), path);
  if (leased_) patience_ = longestWait() / 2;
  alone_ = Clock::now().time_since_epoch().count();
  place_ = "/proc/self/fd/" + std::to_string(file_);
}

bool LeasedFile::keptAt(Clock::time_point now) const noexcept {
  if (!leased_) return true;
  // While another process waits, F_GETLEASE returns the type to which the lease must change.
  if (fcntl(file_, F_GETLEASE) == F_RDLCK) {
    alone_ = now.time_since_epoch().count();
    return true;
  }
  return now.time_since_epoch() - Clock::duration(alone_.load()) < patience_;
}

LeasedFile::~LeasedFile() {
  if (file_ >= 0) close(file_);
}

}  // namespace palpate
