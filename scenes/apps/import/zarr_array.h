/// Private to the importer: reads parts of arrays in Zarr version 2. Source: Zarr storage
/// specification version 2 (zarr-specs.readthedocs.io).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json.hpp>

#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/values.h"
#include "palpate/scenes/apps/import/zarr_chunk.h"

namespace palpate::importer {

/// Reads a file of JSON metadata. Throws VolumeError if the file is unreadable, larger than 16 MiB,
/// nested more than 64 levels deep, or not a JSON object.
[[nodiscard]] nlohmann::json readZarrJson(const std::filesystem::path& file);

/// Content of a file .zarray.
struct ZarrLayout {
  std::vector<int> shape;   ///< Number of values along each axis, at least 1.
  std::vector<int> chunks;  ///< Number of values of a chunk along each axis.
  Type type = Type::kUint8;
  bool half = false;  ///< True if chunks have floats of 16 bits, which become kFloat32.
  bool big_endian = false;
  bool fortran = false;  ///< True if the first axis varies fastest in a chunk, else the last axis.
  ZarrCodec codec = ZarrCodec::kNone;
  char separator = '.';  ///< Character between the indices in a chunk's name.
  /// Value of missing chunks, in the first bytes of `fill`, in the byte order of this machine.
  alignas(8) std::array<char, 8> fill{};
  std::string fill_text;  ///< Value of missing chunks, as text for notes.

  /// Returns the size of a value in a chunk [bytes].
  [[nodiscard]] std::size_t storedBytes() const { return half ? 2 : bytesOf(type); }
};

/// Parses the content of a file .zarray, and checks its sizes. Throws VolumeError, which names
/// `file`.
[[nodiscard]] ZarrLayout parseZarray(const nlohmann::json& json, const std::filesystem::path& file);

/// A box of values: the first index and the number of values along each axis of an array.
struct ZarrBox {
  std::vector<int> first;
  std::vector<int> count;
};

class ZarrArray {
 public:
  /// Reads the metadata of an array in `folder`. Throws VolumeError.
  /// @param has_coarser  True if the image has a coarser level, which messages then suggest.
  ZarrArray(const Request& request, const std::filesystem::path& folder, bool has_coarser = false);

  [[nodiscard]] const std::filesystem::path& header() const { return header_; }
  [[nodiscard]] const ZarrLayout& layout() const { return layout_; }

  /// Reads the values of `part`, the last axis fastest. Reads only the chunks of `part`. The first
  /// call for a box `whole`, which contains `part`, checks the files of all chunks of `whole`. A
  /// call may repeat this check after checks of more than 4 million chunks. Throws VolumeError.
  [[nodiscard]] Values read(const ZarrBox& whole, const ZarrBox& part, const Progress& progress);

  /// Return the sum over all calls of read(): the chunks of `whole`, and those that are missing.
  [[nodiscard]] std::size_t checkedChunks() const { return checked_; }
  [[nodiscard]] std::size_t missingChunks() const { return missing_; }

 private:
  /// Sizes of the files of a box's chunks [bytes], the last axis fastest. 0: the chunk is missing.
  struct Found {
    std::vector<std::size_t> held;
    std::size_t missing = 0;
  };

  [[noreturn]] void refuse(const std::string& why, const std::string& remedy) const;
  [[nodiscard]] double chunkBytes() const;
  [[nodiscard]] std::filesystem::path nameOf(const std::vector<int>& index) const;
  [[nodiscard]] std::size_t heldBy(const std::filesystem::path& chunk) const;
  [[nodiscard]] std::string orCoarser(const std::string& remedy) const;
  [[nodiscard]] ZarrBox chunksOf(const ZarrBox& box) const;
  [[nodiscard]] const Found& findChunks(const ZarrBox& whole);
  void copyChunk(const std::vector<int>& index, const char* values, const ZarrBox& part,
                 char* to) const;

  std::filesystem::path header_;
  bool follow_ = false;
  bool is_sliced_ = false;  ///< True if the caller asks for a part of the image at a time.
  bool has_coarser_ = false;
  ZarrLayout layout_;
  /// Results of findChunks(), by the first index and the number of values along each axis.
  std::map<std::pair<std::vector<int>, std::vector<int>>, Found> found_;
  std::size_t checked_ = 0;
  std::size_t missing_ = 0;
};

}  // namespace palpate::importer
