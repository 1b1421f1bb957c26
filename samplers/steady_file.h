/// Private to samplers: a file that stays as it is while it is read. Include it in .cpp files only.
#pragma once

#include <atomic>
#include <chrono>
#include <filesystem>

namespace palpate {

/// Keeps others from changing a file, or reads another one that nobody knows of.
///
/// OpenVDB reads the leaves of a tree out of a map of the file: where somebody cuts the file off
/// meanwhile the system ends the program (SIGBUS). So whoever opens the file to write to it, or
/// cuts it off, is made to wait for as long as this lives, by a lease (fcntl(2), F_SETLEASE). The
/// system lets nobody wait for longer than /proc/sys/fs/lease-break-time, 45 s as a rule: whoever
/// reads for long asks kept() between one part and the next. Where there is no lease to be had
/// (somebody writes to the file already, it is another user's, or on a network) a copy is made, in
/// the folder for temporary files, and nobody else can open it; where there is no room for it
/// there, in memory. So what is checked is what is read, however often it is opened.
///
/// Not for writing. Costs two system calls; a copy what it takes to copy.
class SteadyFile {
 public:
  using Clock = std::chrono::steady_clock;  ///< Of keptAt(): never set back.

  /// Throws VolumeError: it cannot be read, or others may change it and it cannot be copied.
  explicit SteadyFile(const std::filesystem::path& path);
  SteadyFile(const SteadyFile&) = delete;
  SteadyFile& operator=(const SteadyFile&) = delete;
  ~SteadyFile();

  /// What is to be opened instead of the path, which may lead elsewhere by then.
  [[nodiscard]] const std::filesystem::path& place() const noexcept { return place_; }

  /// True: whoever came to change it is kept from that for half of the system's time at least from
  /// now. False: what is not yet read must not be read any more. By any thread; a system call.
  [[nodiscard]] bool kept() const noexcept { return keptAt(Clock::now()); }
  /// The same if it were that late. `now` never falls.
  [[nodiscard]] bool keptAt(Clock::time_point now) const noexcept;

 private:
  int file_ = -1;
  bool leased_ = false;
  Clock::duration patience_{};                ///< Half of the system's time.
  mutable std::atomic<Clock::rep> alone_{0};  ///< When nobody waited, the last time it was asked.
  std::filesystem::path place_;
};

}  // namespace palpate
