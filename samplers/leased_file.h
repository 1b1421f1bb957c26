/// Private to samplers: a file that stays unchanged while it is read. Include it in .cpp files
/// only.
#pragma once

#include <atomic>
#include <chrono>
#include <filesystem>

namespace palpate {

/// Prevents other programs from changing a file by a lease, or else makes a private copy of the
/// file.
///
/// OpenVDB reads the leaves of a tree from a memory map of the file. If a process truncates the
/// file during that time, the system ends this program (SIGBUS). A lease (fcntl(2), F_SETLEASE)
/// prevents that: while this object lives, the system blocks every process that truncates the file
/// or opens it for writing. The system blocks such a process for at most
/// /proc/sys/fs/lease-break-time, by default 45 s. So a long read must call kept() between its
/// parts.
///
/// The system refuses the lease if a program is already writing to the file, if another user owns
/// the file, or if the file is on a network. Then the object makes a copy that no other program can
/// open. The copy is in the folder for temporary files, or in memory if that folder has no room. So
/// the checks and all later readings see the same content.
///
/// For reading only. Cost: two system calls, or the time to copy the file.
class LeasedFile {
 public:
  using Clock = std::chrono::steady_clock;  ///< Monotonic clock of keptAt().

  /// Takes the lease or makes the copy. Throws VolumeError if the file cannot be read, or if it can
  /// be neither leased nor copied.
  explicit LeasedFile(const std::filesystem::path& path);
  LeasedFile(const LeasedFile&) = delete;
  LeasedFile& operator=(const LeasedFile&) = delete;
  ~LeasedFile();

  /// Returns the path under which to open the file. The original path may lead to another file in
  /// the meantime.
  [[nodiscard]] const std::filesystem::path& place() const noexcept { return place_; }

  /// Returns true if a program that wants to change the file stays blocked for at least half of the
  /// system's limit from now on. If false, do not read any further part of the file. Any thread may
  /// call it. Cost: one system call.
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
