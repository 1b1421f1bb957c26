/// Private to samplers: a file that stays as it is while it is read. Include it in .cpp files only.
#pragma once

#include <filesystem>
#include <string>

namespace palpate {

/// Keeps others from changing a file, or reads another one that nobody knows of.
///
/// OpenVDB reads the leaves of a tree out of a map of the file: where somebody cuts the file off
/// meanwhile the system ends the program (SIGBUS). So whoever opens the file to write to it, or
/// cuts it off, is made to wait for as long as this lives, by a lease (fcntl(2), F_SETLEASE); the
/// system breaks it after /proc/sys/fs/lease-break-time, 45 s as a rule. Where there is none to be
/// had (somebody writes to the file already, it is another user's, or on a network) a copy is made,
/// in the folder for temporary files, and nobody else can open it. Where there is no room for a
/// copy the file is read as it is, by whoever takes care that it may end too early: not out of a
/// map.
///
/// Not for writing. Costs two system calls; a copy what it takes to copy.
class SteadyFile {
 public:
  /// Throws VolumeError: it cannot be read.
  explicit SteadyFile(const std::filesystem::path& path);
  SteadyFile(const SteadyFile&) = delete;
  SteadyFile& operator=(const SteadyFile&) = delete;
  ~SteadyFile();

  /// What is to be opened instead of the path, which may lead elsewhere by then.
  [[nodiscard]] const std::filesystem::path& place() const noexcept { return place_; }
  /// Why others may change it nevertheless; empty: they cannot.
  [[nodiscard]] const std::string& trouble() const noexcept { return trouble_; }

 private:
  int file_ = -1;
  std::filesystem::path place_;
  std::string trouble_;
};

}  // namespace palpate
