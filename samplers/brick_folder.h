/// Private to samplers: the files of a folder of bricks. Include it in .cpp files only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>

namespace palpate {

/// A folder that is held: it stays the same one, whatever becomes of its name.
class BrickFolder {
 public:
  /// Of one that is there. Throws VolumeError.
  /// @param writer  One of several processes that write into it together.
  explicit BrickFolder(std::filesystem::path path, int writer = 0);
  BrickFolder(const BrickFolder&) = delete;
  BrickFolder& operator=(const BrickFolder&) = delete;
  ~BrickFolder();

  /// As it was given.
  [[nodiscard]] const std::filesystem::path& path() const noexcept { return path_; }
  /// It has been removed.
  [[nodiscard]] bool isGone() const noexcept;
  /// What changes when a file or a folder is replaced.
  struct Stamp {
    std::uint64_t device = 0;  ///< Where it is,
    std::uint64_t file = 0;    ///< and which there.
    std::int64_t time = 0;     ///< When a file was written [ns].

    [[nodiscard]] bool isNone() const noexcept { return *this == Stamp(); }  ///< There was none.
    [[nodiscard]] bool operator==(const Stamp&) const = default;  ///< For the same, unchanged.
  };
  /// Of the folder itself; not of what is in it.
  [[nodiscard]] Stamp stamp() const noexcept;
  /// Of a file in it; none where there is none.
  [[nodiscard]] Stamp stampOf(const std::string& name) const noexcept;

  /// It holds something of that name.
  [[nodiscard]] bool has(const std::string& name) const noexcept;

  /// Reads a file into `to`, as much of it as there is room for.
  /// @return  0, or errno; EISDIR for what is no file.
  [[nodiscard]] int read(const std::string& name, std::span<std::byte> to,
                         std::size_t& got) const noexcept;

  /// Nobody else writes into it from here on. Throws Error where somebody does.
  void lock();
  /// Makes a folder in it, if there is none.
  void makeFolder(const std::string& name) const;
  /// A file that is there whole or not at all, in place of what has its name. Throws Error.
  void write(const std::string& name, std::span<const std::byte> bytes) const;
  void write(const std::string& name, const std::string& text) const;  ///< Likewise.
  /// What others, who were ended, have begun to write. Also after the last write.
  void removePartial() const;
  /// Until here everything is on the disk.
  void sync() const;

 private:
  [[noreturn]] void fail(const std::string& name, int error) const;

  std::filesystem::path path_;
  int writer_;
  int folder_ = -1;
};

}  // namespace palpate
