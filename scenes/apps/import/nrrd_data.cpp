#include "palpate/scenes/apps/import/nrrd_data.h"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <sstream>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/unpacked.h"
#include "palpate/scenes/apps/import/values.h"

namespace palpate::importer {

std::string teemError() {
  char* text = biffGetDone(NRRD);
  if (text == nullptr) return "unknown error";
  std::istringstream lines(text);
  std::free(text);  // NOLINT(cppcoreguidelines-no-malloc): teem allocated it by malloc
  std::string line;
  std::string last;
  while (std::getline(lines, line)) {
    if (!line.empty()) last = line;
  }
  const auto colon = last.find(": ");  // the message is "[nrrd] function: what"
  if (colon != std::string::npos) last.erase(0, colon + 2);
  for (char& c : last) {
    if (std::iscntrl(static_cast<unsigned char>(c)) != 0) c = ' ';
  }
  constexpr std::size_t kLongest = 160;
  if (last.size() > kLongest) last = last.substr(0, kLongest) + " ...";
  return last;
}

NrrdData::NrrdData(const Request& request, std::vector<NrrdPart> parts, Nrrd* nrrd,
                   NrrdIoState* state)
    : request_(request), parts_(std::move(parts)), nrrd_(nrrd), state_(state) {
  std::vector<double> sizes;
  sizes.reserve(nrrd_->dim);
  for (int a = 0; a < static_cast<int>(nrrd_->dim); ++a) {
    sizes.push_back(static_cast<double>(nrrd_->axis[a].size));
  }
  static_cast<void>(bytesOf(request_.file, sizes, static_cast<double>(nrrdElementSize(nrrd_))));
  const std::size_t count = nrrdElementNumber(nrrd_);
  if (count == 0 || count % parts_.size() != 0) {
    refuse(fmt::format("{} values cannot be divided among {} data files", count, parts_.size()),
           kCorrectNrrdHeader);
  }
  part_values_ = count / parts_.size();
  const double bytes = static_cast<double>(part_values_ * nrrdElementSize(nrrd_));
  for (const NrrdPart& part : parts_) {
    const double size = sizeOfData(request_.file, part.file, request_.follow);
    double least = bytes;
    if (state_->encoding == nrrdEncodingGzip) least = leastDeflated(bytes);
    if (state_->encoding == nrrdEncodingAscii) {
      least = leastText(static_cast<double>(part_values_));
    }
    if (state_->encoding == nrrdEncodingHex) least = 2.0 * bytes;
    if (state_->encoding == nrrdEncodingBzip2 || state_->encoding == nrrdEncodingZRL) least = 0.0;
    checkHeld(request_.file, part.file, size - static_cast<double>(part.offset), least);
  }
}

void NrrdData::refuse(const std::string& why, const std::string& remedy) const {
  throw VolumeError(request_.file.string(), why, remedy);
}

/// Rejects long words, because teem reads a word into 1024 characters without a check.
void NrrdData::checkWords(std::FILE* in) const {
  const long start = std::ftell(in);
  constexpr int kLongest = 500;
  int length = 0;
  for (int c = std::fgetc(in); c != EOF; c = std::fgetc(in)) {
    length = std::isspace(c) != 0 ? 0 : length + 1;
    if (length > kLongest) {
      refuse("the text has a word of more than 500 characters, too long for a number",
             kNrrdDamaged);
    }
  }
  std::fseek(in, start, SEEK_SET);
}

/// Decompresses `bytes` bytes of a part, from byte `first` of its values on, into `to`. The
/// compressed data begin at `offset`. The first call for a file also verifies its checksum.
void NrrdData::unpackPart(const NrrdPart& part, long offset, long skip, std::size_t first,
                          std::size_t bytes, char* to) {
  const auto open = [&] {
    return std::make_unique<Unpacked>(request_.file, part.file, Packing::kExpected,
                                      static_cast<std::uint64_t>(offset));
  };
  auto before = static_cast<std::uint64_t>(std::max(skip, 0L));
  // the values end `-skip - 1` bytes before the end, which only decompression finds
  if (skip < 0) {
    const std::uint64_t needed =
        part_values_ * nrrdElementSize(nrrd_) + (static_cast<std::uint64_t>(-(skip + 1)));
    const std::uint64_t there = open()->finish();
    if (there < needed) {
      refuse(fmt::format("{} has {} bytes after unpacking, but the header needs {}",
                         part.file.filename().string(), there, needed),
             kNrrdDamaged);
    }
    before = there - needed;
  }
  const std::unique_ptr<Unpacked> in = open();
  in->skip(before + first);
  in->read(to, bytes);
  if (sound_.insert(part.file).second) in->finish();
}

void NrrdData::readPart(const NrrdPart& part, std::size_t first, std::size_t count, char* to) {
  const std::string name = part.file.filename().string();
  const NrrdFile in(std::fopen(part.file.c_str(), "rb"));
  if (in == nullptr) {
    refuse(fmt::format("the data file {} cannot be opened ({})", name, std::strerror(errno)),
           "check its permissions");
  }
  std::fseek(in.get(), part.offset, SEEK_SET);
  if (nrrdLineSkip(in.get(), state_) != 0) refuse(teemError(), kNrrdDamaged);
  const std::size_t size = nrrdElementSize(nrrd_);
  const long skip = part.skip.value_or(state_->byteSkip);
  const NrrdEncoding* encoding = state_->encoding;
  if (encoding == nrrdEncodingGzip) {
    unpackPart(part, std::ftell(in.get()), skip, first * size, count * size, to);
    return;
  }
  bool found = true;
  // the values end `-skip - 1` bytes before the end of the file
  if (encoding->isCompression == 0 && skip < 0) {
    found = std::fseek(in.get(), -static_cast<long>(part_values_ * size) + skip + 1, SEEK_END) == 0;
  } else if (encoding->isCompression == 0) {
    found = std::fseek(in.get(), skip, SEEK_CUR) == 0;
  }
  const bool all = first == 0 && count == part_values_;
  if (encoding == nrrdEncodingRaw && !all) {
    found = found && std::fseek(in.get(), static_cast<long>(first * size), SEEK_CUR) == 0;
  }
  if (!found) refuse(fmt::format("{} is too short", name), kNrrdDamaged);
  if (encoding == nrrdEncodingAscii) checkWords(in.get());
  const long header_skip = state_->byteSkip;
  state_->byteSkip = skip;
  std::vector<char> whole;
  char* target = to;
  std::size_t values = count;
  if (encoding != nrrdEncodingRaw && !all) {
    whole.resize(part_values_ * size);
    target = whole.data();
    values = part_values_;
  }
  const int failed = encoding->read(in.get(), target, values, nrrd_, state_);
  state_->byteSkip = header_skip;
  if (failed != 0) refuse(fmt::format("teem cannot read {} ({})", name, teemError()), kNrrdDamaged);
  if (!whole.empty()) std::memcpy(to, whole.data() + first * size, count * size);
}

void NrrdData::read(std::size_t first, std::size_t count, char* to) {
  const std::size_t size = nrrdElementSize(nrrd_);
  std::size_t done = 0;
  while (done < count) {
    const std::size_t part = (first + done) / part_values_;
    const std::size_t from = (first + done) % part_values_;
    const std::size_t here = std::min(count - done, part_values_ - from);
    readPart(parts_[part], from, here, to + done * size);
    done += here;
    if (request_.progress) {
      request_.progress(static_cast<double>(done) / static_cast<double>(count));
    }
  }
  const bool swap = state_->encoding->endianMatters != 0 && state_->endian != airEndianUnknown &&
                    state_->endian != airMyEndian();
  if (swap) swapBytes(to, count, size);
}

}  // namespace palpate::importer
