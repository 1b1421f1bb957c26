/// Private to samplers: a file that stays unchanged while it is read. Include it in .cpp files
/// only.
#pragma once

#include <atomic>
#include <chrono>
#include <filesystem>

namespace palpate {

/// Keeps other programs from changing a file, by a lease, or reads a private copy.
///
/// OpenVDB reads the leaves of a tree from a memory map of the file. If a process truncates the
/// file during that, the system ends the program (SIGBUS). So a lease (fcntl(2), F_SETLEASE) blocks
/// every process that opens the file for writing or truncates it, while this object lives. The
/// system blocks it for at most /proc/sys/fs/lease-break-time, 45 s by default. So a long read must
/// check kept() between its parts.
///
/// The system may refuse the lease: a program writes to the file already, another user owns it, or
/// it is on a network. Then the object makes a copy that no other program can open. The copy is in
/// the folder for temporary files, or in memory if that folder has no room. So the file that is
/// checked is the file that is read, however often it is opened.
///
/// For reading only. Cost: two system calls; for a copy, the time to copy.
class LeasedFile {
 public:
  using Clock = std::chrono::steady_clock;  ///< Clock of keptAt(): it never goes back.

  /// Throws VolumeError if the file cannot be read, or if another program may change it and it
  /// cannot be copied.
  explicit LeasedFile(const std::filesystem::path& path);
  LeasedFile(const LeasedFile&) = delete;
  LeasedFile& operator=(const LeasedFile&) = delete;
  ~LeasedFile();

  /// The path to open in place of the original path, which may lead elsewhere by then.
  [[nodiscard]] const std::filesystem::path& place() const noexcept { return place_; }

  /// Returns true if a program that wants to change the file stays blocked for at least half of the
  /// system's limit from now. False: the parts that are not yet read must not be read any more.
  /// Safe in any thread; a system call.
  [[nodiscard]] bool kept() const noexcept { return keptAt(Clock::now()); }
  /// Does the same for the time `now`, which must not decrease from call to call.
  [[nodiscard]] bool keptAt(Clock::time_point now) const noexcept;

 private:
  int file_ = -1;
  bool leased_ = false;
  Clock::duration patience_{};                ///< Half of the system's limit.
  mutable std::atomic<Clock::rep> alone_{0};  ///< Time of the last check that found no program
                                              ///< waiting.
  std::filesystem::path place_;
};

}  // namespace palpate
