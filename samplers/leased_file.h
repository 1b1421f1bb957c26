/// Private to samplers, for .cpp files only: a file that stays unchanged while it is read.
#pragma once

#include <atomic>
#include <chrono>
#include <filesystem>
#include <string>
#include <system_error>

namespace palpate {

/// Throws VolumeError for a path at which std::filesystem::status() found no file. If `error`
/// states that the path does not exist, the reason is `what`; otherwise the reason has the text of
/// `error`.
/// @param error  Error of std::filesystem::status() for the path.
[[noreturn]] void throwAbsent(const std::filesystem::path& path, const std::string& what,
                              const std::error_code& error);

/// Keeps a file unchanged while it is read: holds a lease of the file, or makes a private copy.
///
/// OpenVDB reads leaves from a memory map of the file. If a process truncates the file during that
/// time, the system ends this program (SIGBUS). While this object holds a lease (fcntl(2),
/// F_SETLEASE), the system blocks processes that truncate the file or open it for writing. The
/// system blocks them for at most the time in /proc/sys/fs/lease-break-time [s], by default 45 s.
/// So the caller must check kept() between the parts of a long read.
///
/// The system refuses a lease, for example, if a program has the file open for writing, another
/// user owns the file, or the file is on a network file system. Then the object makes a copy that
/// no other program can open. The copy is in the folder for temporary files or, if that fails, in
/// memory.
///
/// For reading only. Cost: a few system calls, or the time to copy the file.
class LeasedFile {
 public:
  using Clock = std::chrono::steady_clock;  ///< Monotonic clock of keptAt().

  /// Throws VolumeError if the file is unreadable, or can be neither leased nor copied.
  explicit LeasedFile(const std::filesystem::path& path);
  LeasedFile(const LeasedFile&) = delete;
  LeasedFile& operator=(const LeasedFile&) = delete;
  ~LeasedFile();

  /// Returns the path to open. It differs from the original path, which may lead to another file by
  /// now.
  [[nodiscard]] const std::filesystem::path& place() const noexcept { return place_; }

  /// Returns true if the file cannot change soon: always for a copy; with a lease, if a program
  /// that wants to change the file must still wait for at least half of the system's limit. If
  /// false, read no more of the file. Thread-safe. Cost: one system call with a lease.
  [[nodiscard]] bool kept() const noexcept { return keptAt(Clock::now()); }
  /// Returns kept() for the time `now`, which must not decrease from call to call.
  [[nodiscard]] bool keptAt(Clock::time_point now) const noexcept;

 private:
  int file_ = -1;
  bool leased_ = false;
  Clock::duration patience_{};  ///< Half of the system's limit.
  /// Time of the last check at which no other program waited.
  mutable std::atomic<Clock::rep> alone_{0};
  std::filesystem::path place_;
};

}  // namespace palpate
