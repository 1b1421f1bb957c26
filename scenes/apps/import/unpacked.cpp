#include "palpate/scenes/apps/import/unpacked.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <utility>
#include <zlib.h>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/header_checks.h"

namespace palpate::importer {
namespace {

constexpr std::size_t kChunk = 1U << 18U;

/// Returns true if the stream begins with the two magic bytes of gzip, the method deflate, and
/// flags whose upper three bits are 0.
bool beginsAsGzip(std::istream& in) {
  std::array<unsigned char, 4> head{};
  in.read(reinterpret_cast<char*>(head.data()), head.size());
  const bool gzip = in && head[0] == 0x1f && head[1] == 0x8b && head[2] == 8 && head[3] < 0x20;
  in.clear();
  return gzip;
}

}  // namespace

bool isGzip(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return beginsAsGzip(in);
}

struct Unpacked::Inflater {
  Inflater() {
    constexpr int kGzipOrZlib = 15 + 32;
    usable = inflateInit2(&stream, kGzipOrZlib) == Z_OK;
  }
  Inflater(const Inflater&) = delete;
  Inflater& operator=(const Inflater&) = delete;
  ~Inflater() { inflateEnd(&stream); }

  z_stream stream{};
  std::vector<char> packed = std::vector<char>(kChunk);
  bool usable = false;
  bool gzip = false;
  bool ended = false;
};

Unpacked::Unpacked(std::filesystem::path header, std::filesystem::path data, Packing packing,
                   std::uint64_t offset)
    : header_(std::move(header)), data_(std::move(data)), in_(data_, std::ios::binary) {
  const auto place = static_cast<std::streamoff>(offset);
  if (!in_.seekg(place)) {
    throw VolumeError(header_.string(), fmt::format("{} cannot be read", calledBy(header_, data_)),
                      "check the permissions");
  }
  const bool gzip = beginsAsGzip(in_);
  in_.seekg(place);
  if (!gzip && packing == Packing::kAsFound) return;
  inflater_ = std::make_unique<Inflater>();
  inflater_->gzip = gzip;
  if (!inflater_->usable) refuse("cannot be unpacked");
}

Unpacked::~Unpacked() = default;

void Unpacked::refuse(const std::string& why) const {
  throw VolumeError(header_.string(), fmt::format("{} {}", calledBy(header_, data_), why),
                    "copy or export the file again, or correct the header");
}

/// Reads more compressed bytes if none are left. Returns false at the end of the file.
bool Unpacked::refill() {
  z_stream& stream = inflater_->stream;
  if (stream.avail_in > 0) return true;
  in_.read(inflater_->packed.data(), static_cast<std::streamsize>(kChunk));
  if (in_.bad()) refuse("cannot be read to the end");
  stream.next_in = reinterpret_cast<Bytef*>(inflater_->packed.data());
  stream.avail_in = static_cast<uInt>(in_.gcount());
  return stream.avail_in > 0;
}

std::size_t Unpacked::inflateSome(void* to, std::size_t bytes) {
  z_stream& stream = inflater_->stream;
  constexpr std::size_t kMost = 1U << 30U;
  const std::size_t room = std::min(bytes, kMost);
  stream.next_out = static_cast<Bytef*>(to);
  stream.avail_out = static_cast<uInt>(room);
  while (stream.avail_out > 0 && !inflater_->ended) {
    if (!refill()) refuse("is truncated: the packed values end too early");
    const int state = inflate(&stream, Z_NO_FLUSH);
    if (state == Z_STREAM_END) {
      // Another gzip member may follow, as in files of bgzip. All other bytes are ignored.
      inflater_->ended = !inflater_->gzip || !refill() || *stream.next_in != 0x1f;
      if (!inflater_->ended) inflateReset(&stream);
    } else if (state != Z_OK) {
      refuse(fmt::format("is damaged{}: the packed values cannot be unpacked ({})",
                         inflater_->gzip ? "" : ", or not packed as the header states",
                         stream.msg == nullptr ? zError(state) : stream.msg));
    }
  }
  return room - stream.avail_out;
}

std::size_t Unpacked::readSome(void* to, std::size_t bytes) {
  std::size_t done = 0;
  if (inflater_ == nullptr) {
    in_.read(static_cast<char*>(to), static_cast<std::streamsize>(bytes));
    if (in_.bad()) refuse("cannot be read to the end");
    done = static_cast<std::size_t>(in_.gcount());
  } else {
    while (done < bytes) {
      const std::size_t got = inflateSome(static_cast<char*>(to) + done, bytes - done);
      if (got == 0) break;
      done += got;
    }
  }
  given_ += done;
  return done;
}

void Unpacked::read(void* to, std::size_t bytes, const Progress& progress) {
  constexpr std::size_t kPart = 1U << 24U;
  for (std::size_t done = 0; done < bytes;) {
    const std::size_t part = std::min(bytes - done, kPart);
    if (readSome(static_cast<char*>(to) + done, part) != part) {
      refuse("is truncated, or its header states too many values");
    }
    done += part;
    if (progress) progress(static_cast<double>(done) / static_cast<double>(bytes));
  }
}

void Unpacked::skip(std::uint64_t bytes) {
  if (inflater_ == nullptr) {
    in_.seekg(static_cast<std::streamoff>(bytes), std::ios::cur);
    if (!in_) refuse("is truncated, or its header states too many values");
    given_ += bytes;
    return;
  }
  std::vector<char> unused(std::min<std::uint64_t>(bytes, kChunk));
  for (std::uint64_t left = bytes; left > 0;) {
    const auto part = static_cast<std::size_t>(std::min<std::uint64_t>(left, unused.size()));
    read(unused.data(), part);
    left -= part;
  }
}

std::uint64_t Unpacked::finish() {
  std::vector<char> unused(inflater_ == nullptr ? 0 : kChunk);
  while (!unused.empty() && readSome(unused.data(), unused.size()) > 0) {
  }
  return given_;
}

}  // namespace palpate::importer
