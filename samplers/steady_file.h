/// Private to samplers: a file that stays as it is while it is read. Include it in .cpp files only.
#pragma once

#include <filesystem>

namespace palpate {

/// Keeps others from changing a file, or reads another one that nobody knows of.
///
/// OpenVDB reads the leaves of a tree out of a map of the file: where somebody cuts the file off
/// meanwhile the system ends the program (SIGBUS). So whoever opens the file to write to it, or
/// cuts it off, is made to wait for as long as this lives, by a lease (fcntl(2), F_SETLEASE); the
/// system breaks it after /proc/sys/fs/lease-break-time, 45 s as a rule. Where there is none to be
/// had (somebody writes to the file already, it is another user's, or on a network) a copy is made,
/// in the folder for temporary files, and nobody else can open it; where there is no room for it
/// there, in memory. So what is checked is what is read, however often it is opened.
///
/// Not for writing. Costs two system calls; a copy what it takes to copy.
class SteadyFile {
 public:
  /// Throws VolumeError: it cannot be read, or others may change it and it cannot be copied.
  explicit SteadyFile(const std::filesystem::path& path);
  SteadyFile(const SteadyFile&) = delete;
  SteadyFile& operator=(const SteadyFile&) = delete;
  ~SteadyFile();

  /// What is to be opened instead of the path, which may lead elsewhere by then.
  [[nodiscard]] const std::filesystem::path& place() const noexcept { return place_; }

 private:
  int file_ = -1;
  std::filesystem::path place_;
};

}  // namespace palpate
