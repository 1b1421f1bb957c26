/// Private to the importer: the bytes of a file, unpacked where they are packed. What it gives of a
/// packed file is only good once `finish` has found its sums right.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// Whether it begins as gzip does, whatever its name.
[[nodiscard]] bool isGzip(const std::filesystem::path& file);

/// How the bytes of a file are known to be packed.
enum class Packing : std::uint8_t {
  kAsFound,   ///< By gzip where they begin so, else not.
  kExpected,  ///< By gzip or zlib.
};

/// Reads a file from front to back. Everything throws VolumeError, of `header`, where the file
/// cannot be read, ends too soon or is damaged.
class Unpacked {
 public:
  /// Of a data file, perhaps the header's own, what stands behind its first `offset` bytes.
  Unpacked(std::filesystem::path header, std::filesystem::path data,
           Packing packing = Packing::kAsFound, std::uint64_t offset = 0);
  Unpacked(const Unpacked&) = delete;
  Unpacked& operator=(const Unpacked&) = delete;
  ~Unpacked();

  /// Fills `to`, or as much of it as there is; how much that was.
  std::size_t readSome(void* to, std::size_t bytes);
  /// Fills all of `to`.
  void read(void* to, std::size_t bytes, const Progress& progress = nullptr);
  void skip(std::uint64_t bytes);
  /// Of what is packed: reads the rest, up to where and with the sums that the packer wrote. How
  /// many bytes it was in all.
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
