/// Private to the importer: reads a file, and decompresses it if it is compressed.
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

/// Returns true if the file begins with a gzip header, whatever its name.
[[nodiscard]] bool isGzip(const std::filesystem::path& file);

enum class Packing : std::uint8_t {
  kAsFound,   ///< Gzip if the file begins with a gzip header, else not compressed.
  kExpected,  ///< Gzip or zlib.
};

/// Reads a file, and decompresses it if it is compressed. Only finish() verifies the checksum of a
/// compressed file. All functions throw VolumeError, which names `header`, if the file is damaged
/// or too short.
class Unpacked {
 public:
  /// Opens a data file, which may be the header file itself, and skips its first `offset` bytes.
  Unpacked(std::filesystem::path header, std::filesystem::path data,
           Packing packing = Packing::kAsFound, std::uint64_t offset = 0);
  Unpacked(const Unpacked&) = delete;
  Unpacked& operator=(const Unpacked&) = delete;
  ~Unpacked();

  /// Reads up to `bytes` bytes. Returns their number, which is smaller only at the end of the data.
  std::size_t readSome(void* to, std::size_t bytes);
  void read(void* to, std::size_t bytes, const Progress& progress = nullptr);
  void skip(std::uint64_t bytes);
  /// Reads a compressed file to the end, and verifies its checksums. Returns the number of bytes
  /// that all calls have read or skipped.
  std::uint64_t finish();

 private:
  struct Inflater;

  [[noreturn]] void refuse(const std::string& why) const;
  bool refill();
  std::size_t inflateSome(void* to, std::size_t bytes);

  std::filesystem::path header_;
  std::filesystem::path data_;
  std::ifstream in_;
  std::unique_ptr<Inflater> inflater_;
  std::uint64_t given_ = 0;
};

}  // namespace palpate::importer
