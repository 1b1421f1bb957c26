/// Private to samplers: the files of a folder of bricks. Include it in .cpp files only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>

namespace palpate {

/// An open folder: it remains the same folder if its path is renamed or replaced.
class BrickFolder {
 public:
  /// Opens an existing folder. Throws VolumeError.
  /// @param writer  Number of this process among those that write into the folder together.
  explicit BrickFolder(std::filesystem::path path, int writer = 0);
  BrickFolder(const BrickFolder&) = delete;
  BrickFolder& operator=(const BrickFolder&) = delete;
  ~BrickFolder();

  /// Returns the path as it was given.
  [[nodiscard]] const std::filesystem::path& path() const noexcept { return path_; }
  /// Returns true if the folder has been removed.
  [[nodiscard]] bool isGone() const noexcept;
  /// Identifies a version of a file or folder: changes when the file or folder is replaced.
  struct Stamp {
    std::uint64_t device = 0;  ///< Number of the device.
    std::uint64_t file = 0;    ///< Number of the file on the device.
    std::int64_t time = 0;     ///< When a file was written [ns].

    /// Returns true if the file was not found.
    [[nodiscard]] bool isNone() const noexcept { return *this == Stamp(); }
    [[nodiscard]] bool operator==(const Stamp&) const = default;  ///< Same file, unchanged.
  };
  /// Returns the stamp of the folder itself, not of its content.
  [[nodiscard]] Stamp stamp() const noexcept;
  /// Returns the stamp of a file in the folder; isNone() if the file does not exist.
  [[nodiscard]] Stamp stampOf(const std::string& name) const noexcept;

  /// Returns true if the folder holds this name.
  [[nodiscard]] bool has(const std::string& name) const noexcept;

  /// Reads a file into `to`, at most as much as fits.
  /// @return  0, or errno; EISDIR if the name is not a regular file.
  [[nodiscard]] int read(const std::string& name, std::span<std::byte> to,
                         std::size_t& got) const noexcept;

  /// Locks the folder against other writers. Throws Error if any other BrickFolder has the lock.
  void lock();
  /// Makes a folder in this one if it does not exist.
  void makeFolder(const std::string& name) const;
  /// Writes a whole file or leaves the old one, if any, unchanged. Throws Error.
  void write(const std::string& name, std::span<const std::byte> bytes) const;
  /// Writes text in the same way.
  void write(const std::string& name, const std::string& text) const;
  /// Removes partial files that terminated processes left. Call it also after the last write.
  void removePartial() const;
  /// Returns after all earlier writes are on the disk.
  void sync() const;

 private:
  [[noreturn]] void fail(const std::string& name, int error) const;

  std::filesystem::path path_;
  int writer_;
  int folder_ = -1;
};

}  // namespace palpate
