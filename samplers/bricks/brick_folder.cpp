#include "palpate/samplers/bricks/brick_folder.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <system_error>
#include <unistd.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/descriptor.h"

namespace palpate {
namespace {

/// Folder of the files that are being written. Complete files are moved to their final places.
constexpr const char* kPartial = ".partial";

}  // namespace

BrickFolder::BrickFolder(std::filesystem::path path, int writer)
    : path_(std::move(path)),
      writer_(writer),
      folder_(::open(path_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC)) {
  if (folder_ >= 0) return;
  throw VolumeError(path_.string(),
                    std::string("the folder cannot be read (") + std::strerror(errno) + ")",
                    "check the path and its permissions");
}

BrickFolder::~BrickFolder() {
  ::close(folder_);
}

bool BrickFolder::isGone() const noexcept {
  struct stat status {};
  return ::fstat(folder_, &status) != 0 || status.st_nlink == 0;
}

BrickFolder::Stamp BrickFolder::stamp() const noexcept {
  struct stat status {};
  if (::fstat(folder_, &status) != 0) return {};
  return {status.st_dev, status.st_ino, 0};
}

BrickFolder::Stamp BrickFolder::stampOf(const std::string& name) const noexcept {
  struct stat status {};
  if (::fstatat(folder_, name.c_str(), &status, 0) != 0) return {};
  constexpr std::int64_t kSecond = 1'000'000'000;
  return {status.st_dev, status.st_ino, status.st_mtim.tv_sec * kSecond + status.st_mtim.tv_nsec};
}

bool BrickFolder::has(const std::string& name) const noexcept {
  return ::faccessat(folder_, name.c_str(), F_OK, 0) == 0;
}

int BrickFolder::read(const std::string& name, std::span<std::byte> to,
                      std::size_t& got) const noexcept {
  got = 0;
  // Without O_NONBLOCK, opening a named pipe would wait until another process opens the pipe.
  const Descriptor file(::openat(folder_, name.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  if (file.get() < 0) return errno;
  struct stat status {};
  if (::fstat(file.get(), &status) != 0) return errno;
  if (!S_ISREG(status.st_mode)) return EISDIR;
  while (got < to.size()) {
    const ssize_t some = ::read(file.get(), to.data() + got, to.size() - got);
    if (some < 0 && errno == EINTR) continue;
    if (some < 0) return errno;
    if (some == 0) break;
    got += static_cast<std::size_t>(some);
  }
  return 0;
}

void BrickFolder::fail(const std::string& name, int error) const {
  const std::string remedy = error == EFBIG ? "raise the limit of file sizes (ulimit -f)"
                             : error == ENOSPC || error == EDQUOT
                                 ? "free disk space"
                                 : "check the disk and the folder's permissions";
  throw Error((path_ / name).string(),
              std::string("it cannot be written (") + std::strerror(error) + ")",
              remedy + ", and run the same command again: it continues where it stopped");
}

void BrickFolder::lock() {
  // On network file systems without locks, a second writer is not detected.
  if (::flock(folder_, LOCK_EX | LOCK_NB) == 0 || errno != EWOULDBLOCK) return;
  throw Error(path_.string(), "another run is writing into it",
              "wait for the end of that run, or name another folder");
}

void BrickFolder::makeFolder(const std::string& name) const {
  if (::mkdirat(folder_, name.c_str(), S_IRWXU | S_IRWXG | S_IRWXO) != 0 && errno != EEXIST) {
    fail(name, errno);
  }
}

void BrickFolder::write(const std::string& name, std::span<const std::byte> bytes) const {
  static std::atomic<unsigned> number{0};
  const std::string partial =
      std::string(kPartial) + "/" + std::to_string(writer_) + "." + std::to_string(number++);
  int error = 0;
  {
    // Removes the file of a terminated run or the link of another user.
    ::unlinkat(folder_, partial.c_str(), 0);
    Descriptor file(::openat(folder_, partial.c_str(),
                             O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC,
                             S_IRUSR | S_IWUSR | S_IRGRP | S_IWGRP | S_IROTH | S_IWOTH));
    if (file.get() < 0) fail(name, errno);
    for (std::size_t done = 0; done < bytes.size() && error == 0;) {
      const ssize_t some = ::write(file.get(), bytes.data() + done, bytes.size() - done);
      if (some < 0 && errno != EINTR) error = errno;
      done += static_cast<std::size_t>(std::max<ssize_t>(some, 0));
    }
    if (!file.close() && error == 0) error = errno;
  }
  if (error == 0 && ::renameat(folder_, partial.c_str(), folder_, name.c_str()) != 0) error = errno;
  if (error == 0) return;
  ::unlinkat(folder_, partial.c_str(), 0);
  fail(name, error);
}

void BrickFolder::write(const std::string& name, const std::string& text) const {
  write(name, std::as_bytes(std::span(text)));
}

void BrickFolder::removePartial() const {
  std::error_code error;
  std::filesystem::remove_all(path_ / kPartial, error);
}

void BrickFolder::sync() const {
  if (::syncfs(folder_) != 0) fail("", errno);
}

}  // namespace palpate
