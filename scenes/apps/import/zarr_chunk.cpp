#include "palpate/scenes/apps/import/zarr_chunk.h"

#include <blosc.h>
#include <fstream>
#include <string>
#include <vector>
#include <zstd.h>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/unpacked.h"

namespace palpate::importer {
namespace {

/// Smallest size after zstd, alone or within Blosc [bytes]. A block of 128 KiB equal bytes takes 4.
constexpr double leastZstd(double bytes) noexcept {
  return bytes / 32768.0;
}
/// Largest size of a compressed chunk [bytes]. Compressors add less than this to random values.
constexpr double mostPacked(double bytes) noexcept {
  return 1.1 * bytes + 65536.0;
}

[[noreturn]] void refuseChunk(const std::filesystem::path& header,
                              const std::filesystem::path& chunk, const std::string& why) {
  throw VolumeError(header.string(), fmt::format("the chunk {} {}", calledBy(header, chunk), why),
                    "copy or export the array again");
}

void readFileOf(const std::filesystem::path& header, const std::filesystem::path& chunk,
                std::span<char> to) {
  std::ifstream in(chunk, std::ios::binary);
  in.read(to.data(), static_cast<std::streamsize>(to.size()));
  if (!in) refuseChunk(header, chunk, "cannot be read to the end");
}

}  // namespace

void checkChunkSize(const std::filesystem::path& header, const std::filesystem::path& chunk,
                    ZarrCodec codec, double held, double bytes) {
  double least = bytes;
  if (codec == ZarrCodec::kDeflate) least = leastDeflated(bytes);
  if (codec == ZarrCodec::kZstd || codec == ZarrCodec::kBlosc) least = leastZstd(bytes);
  checkHeld(header, chunk, held, least);
  if (held > (codec == ZarrCodec::kNone ? bytes : mostPacked(bytes))) {
    refuseChunk(
        header, chunk,
        fmt::format("has {:.0f} bytes, too many for its {:.0f} bytes of values", held, bytes));
  }
}

void readChunk(const std::filesystem::path& header, const std::filesystem::path& chunk,
               ZarrCodec codec, std::size_t held, std::span<char> to) {
  if (codec == ZarrCodec::kNone) {
    readFileOf(header, chunk, to);
    return;
  }
  if (codec == ZarrCodec::kDeflate) {
    Unpacked in(header, chunk, Packing::kExpected);
    in.read(to.data(), to.size());
    char more = 0;
    if (in.readSome(&more, 1) > 0) refuseChunk(header, chunk, "has more values than a chunk");
    return;
  }
  std::vector<char> packed(held);
  readFileOf(header, chunk, packed);
  if (codec == ZarrCodec::kZstd) {
    const std::size_t got = ZSTD_decompress(to.data(), to.size(), packed.data(), packed.size());
    if (ZSTD_isError(got) != 0) {
      refuseChunk(header, chunk, fmt::format("is damaged (zstd: {})", ZSTD_getErrorName(got)));
    }
    if (got != to.size()) {
      refuseChunk(header, chunk,
                  fmt::format("has {} bytes of values instead of {}", got, to.size()));
    }
    return;
  }
  std::size_t stated = 0;
  if (blosc_cbuffer_validate(packed.data(), packed.size(), &stated) < 0) {
    refuseChunk(header, chunk, "is damaged (its Blosc header does not match its size)");
  }
  if (stated != to.size()) {
    refuseChunk(header, chunk,
                fmt::format("has {} bytes of values instead of {}", stated, to.size()));
  }
  const int got = blosc_decompress_ctx(packed.data(), to.data(), to.size(), 1);
  if (got < 0 || static_cast<std::size_t>(got) != to.size()) {
    refuseChunk(header, chunk, fmt::format("is damaged (Blosc: error {})", got));
  }
}

}  // namespace palpate::importer
