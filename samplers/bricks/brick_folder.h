/// Private to samplers, for .cpp files only: reads and writes the files in a folder of bricks.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>

namespace palpate {

/// An open folder. The object keeps using this folder if the path is renamed or replaced; only
/// removePartial() uses the path.
class BrickFolder {
 public:
  /// Opens an existing folder. Throws VolumeError.
  /// @param writer  Number of this process, if several processes write into the folder together.
  explicit BrickFolder(std::filesystem::path path, int writer = 0);
  BrickFolder(const BrickFolder&) = delete;
  BrickFolder& operator=(const BrickFolder&) = delete;
  ~BrickFolder();

  /// Returns the path that was passed to the constructor.
  [[nodiscard]] const std::filesystem::path& path() const noexcept { return path_; }
  /// Returns true if the folder has been removed.
  [[nodiscard]] bool isGone() const noexcept;
  /// Identifies a version of a file, or a folder. Changes if the file or folder is replaced, or if
  /// the file is written.
  struct Stamp {
    std::uint64_t device = 0;  ///< Number of the device.
    std::uint64_t file = 0;    ///< Number of the file on the device.
    std::int64_t time = 0;     ///< Time of the last write to the file [ns]; 0 for a folder.

    /// Returns true if no file was found.
    [[nodiscard]] bool isNone() const noexcept { return *this == Stamp(); }
    [[nodiscard]] bool operator==(const Stamp&) const = default;  ///< Same file, unchanged.
  };
  /// Returns the stamp of the folder itself, which does not depend on the files in the folder.
  [[nodiscard]] Stamp stamp() const noexcept;
  /// Returns the stamp of a file in the folder; isNone() if the file does not exist.
  [[nodiscard]] Stamp stampOf(const std::string& name) const noexcept;

  /// Returns true if the folder contains a file or folder of this name.
  [[nodiscard]] bool has(const std::string& name) const noexcept;

  /// Reads a file into `to`, up to the size of `to`. Sets `got` to the number of bytes read.
  /// @return  0, or the errno of the failure; EISDIR if the name does not belong to a regular file.
  [[nodiscard]] int read(const std::string& name, std::span<std::byte> to,
                         std::size_t& got) const noexcept;

  /// Locks the folder against other writers. Throws Error if any other BrickFolder has the lock.
  /// Does nothing on file systems without locks.
  void lock();
  /// Makes a folder inside this folder if it does not exist. Throws Error.
  void makeFolder(const std::string& name) const;
  /// Writes a whole file. On failure an existing file stays unchanged. Throws Error. The folder
  /// .partial must exist (makeFolder).
  void write(const std::string& name, std::span<const std::byte> bytes) const;
  /// Writes a text as the other overload writes bytes.
  void write(const std::string& name, const std::string& text) const;
  /// Removes all partial files and their folder .partial. Call this function only while no process
  /// writes into the folder.
  void removePartial() const;
  /// Waits until all earlier writes are on the disk. Throws Error.
  void sync() const;

 private:
  [[noreturn]] void fail(const std::string& name, int error) const;

  std::filesystem::path path_;
  int writer_;
  int folder_ = -1;
};

}  // namespace palpate
