/// Private to the importer: decompresses the chunks of Zarr arrays.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>

namespace palpate::importer {

enum class ZarrCodec : std::uint8_t {
  kNone,
  kDeflate,  ///< zlib or gzip.
  kZstd,
  kBlosc,
};

/// Throws VolumeError, which names `header` and the chunk, if a file of `held` bytes cannot hold a
/// chunk of `bytes` bytes: it is too small for the best compression, or too large.
void checkChunkSize(const std::filesystem::path& header, const std::filesystem::path& chunk,
                    ZarrCodec codec, double held, double bytes);

/// Reads the file of a chunk into `to`, and decompresses it.
/// @param held  Size of the file [bytes], which checkChunkSize() has accepted.
/// Throws VolumeError, which names `header` and the chunk, if the chunk is damaged, or does not
/// have the size of `to` after decompression.
void readChunk(const std::filesystem::path& header, const std::filesystem::path& chunk,
               ZarrCodec codec, std::size_t held, std::span<char> to);

}  // namespace palpate::importer
