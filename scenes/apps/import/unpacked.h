/// Private to the importer: reads the bytes of a file, and decompresses them if the file is
/// compressed. The bytes of a compressed file are reliable only after `finish` has verified its
/// checksums.
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

/// Returns true if the file begins with a gzip header. The file's name does not matter.
[[nodiscard]] bool isGzip(const std::filesystem::path& file);

/// The compression that a reader expects in a file.
enum class Packing : std::uint8_t {
  kAsFound,   ///< Gzip if the file begins with a gzip header, otherwise none.
  kExpected,  ///< Gzip or zlib.
};

/// Reads a file from its beginning to its end. All functions throw VolumeError, which names
/// `header`, if the file cannot be read, ends too early or is damaged.
class Unpacked {
 public:
  /// Opens a data file and skips its first `offset` bytes. The data file may be the header file
  /// itself.
  Unpacked(std::filesystem::path header, std::filesystem::path data,
           Packing packing = Packing::kAsFound, std::uint64_t offset = 0);
  Unpacked(const Unpacked&) = delete;
  Unpacked& operator=(const Unpacked&) = delete;
  ~Unpacked();

  /// Reads up to `bytes` bytes. Returns the number of bytes read, which is smaller only at the end
  /// of the data.
  std::size_t readSome(void* to, std::size_t bytes);
  /// Reads exactly `bytes` bytes. Throws if the data end before.
  void read(void* to, std::size_t bytes, const Progress& progress = nullptr);
  void skip(std::uint64_t bytes);
  /// Reads a compressed file to its end and verifies its checksums. Returns the number of all bytes
  /// that were read.
  std::uint64_t finish();

 private:
  struct Inflater;

  [[noreturn]] void refuse(const std::string& why) const;
  bool refill();
  std::size_t inflateSome(void* to, std::size_t bytes);

  std::filesystem::path header_;
  std::filesystem::path data_;
  std::ifstream in_;
  std::unique_ptr<Inflater> inflater_;  ///< Null if the file is not compressed.
  std::uint64_t given_ = 0;
};

}  // namespace palpate::importer
