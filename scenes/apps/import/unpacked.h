/// Private to the importer: the bytes of a file, unpacked if it is packed. Bytes of a packed file
/// are only trustworthy once `finish` has verified its checksums.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Returns whether the file begins as gzip does; its name does not matter.
[[nodiscard]] bool isGzip(const std::filesystem::path& file);

/// The packing that a reader assumes for a file.
enum class Packing : std::uint8_t {
  kAsFound,   ///< Gzip if the bytes begin so, else not packed.
  kExpected,  ///< Gzip or zlib.
};

/// Reads a file from front to back. All functions throw VolumeError, of `header`, if the file
/// cannot be read, ends too soon or is damaged.
class Unpacked {
 public:
  /// Opens a data file, perhaps the header's own, behind its first `offset` bytes.
  Unpacked(std::filesystem::path header, std::filesystem::path data,
           Packing packing = Packing::kAsFound, std::uint64_t offset = 0);
  Unpacked(const Unpacked&) = delete;
  Unpacked& operator=(const Unpacked&) = delete;
  ~Unpacked();

  /// Fills `to` as far as bytes are left; returns how many were read.
  std::size_t readSome(void* to, std::size_t bytes);
  /// Fills all of `to`.
  void read(void* to, std::size_t bytes, const Progress& progress = nullptr);
  void skip(std::uint64_t bytes);
  /// Reads a packed file to its end and verifies the packer's checksums. Returns how many bytes
  /// were read in all.
  std::uint64_t finish();

 private:
  struct Inflater;

  [[noreturn]] void refuse(const std::string& why) const;
  bool refill();
  std::size_t inflateSome(void* to, std::size_t bytes);

  std::filesystem::path header_;
  std::filesystem::path data_;
  std::ifstream in_;
  std::unique_ptr<Inflater> inflater_;  ///< Null: not packed.
  std::uint64_t given_ = 0;
};

}  // namespace palpate::importer
