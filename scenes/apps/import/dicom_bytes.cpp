#include "palpate/scenes/apps/import/dicom_bytes.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <optional>
#include <sys/mman.h>
#include <unistd.h>
#include <utility>
#include <vector>
#include <zlib.h>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate::importer {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kPreamble = 128;
constexpr std::size_t kPrefix = kPreamble + 4;
constexpr std::string_view kPlainSyntax = "1.2.840.10008.1.2.1";
constexpr std::string_view kDeflatedSyntax = "1.2.840.10008.1.2.1.99";
constexpr const char* kNoMemory = "the inflated data set needs more memory than is free";
constexpr const char* kTooLarge = "the inflated data set is larger than the limit of 4 GiB";

std::uint32_t numberAt(std::string_view bytes, std::size_t at, std::size_t size) {
  if (at + size > bytes.size()) return 0;
  std::uint32_t number = 0;
  for (std::size_t i = size; i-- > 0;) {
    number = number << 8U | static_cast<unsigned char>(bytes[at + i]);
  }
  return number;
}

struct ElementHead {
  std::uint32_t tag = 0;
  std::size_t value = 0;  ///< Offset of the value in the file.
  std::size_t size = 0;
};

std::optional<ElementHead> elementAt(std::string_view bytes, std::size_t at, bool is_explicit) {
  if (at + 12 > bytes.size()) return std::nullopt;
  ElementHead head;
  head.tag = numberAt(bytes, at, 2) << 16U | numberAt(bytes, at + 2, 2);
  if (!is_explicit) {
    head.value = at + 8;
    head.size = numberAt(bytes, at + 4, 4);
  } else {
    const std::string_view kind = bytes.substr(at + 4, 2);
    static constexpr std::array<std::string_view, 34> kKinds = {
        "AE", "AS", "AT", "CS", "DA", "DS", "DT", "FL", "FD", "IS", "LO", "LT",
        "OB", "OD", "OF", "OL", "OV", "OW", "PN", "SH", "SL", "SQ", "SS", "ST",
        "SV", "TM", "UC", "UI", "UL", "UN", "UR", "US", "UT", "UV"};
    static constexpr std::array<std::string_view, 13> kLong = {
        "OB", "OD", "OF", "OL", "OV", "OW", "SQ", "SV", "UC", "UN", "UR", "UT", "UV"};
    if (std::find(kKinds.begin(), kKinds.end(), kind) == kKinds.end()) return std::nullopt;
    const bool is_long = std::find(kLong.begin(), kLong.end(), kind) != kLong.end();
    head.value = at + (is_long ? 12 : 8);
    head.size = is_long ? numberAt(bytes, at + 8, 4) : numberAt(bytes, at + 6, 2);
  }
  if (head.size % 2 != 0) return std::nullopt;  // DICOM pads each value to an even length
  return head;
}

bool beginsAsDataSet(std::string_view bytes, bool is_explicit) {
  const auto first = elementAt(bytes, 0, is_explicit);
  if (!first.has_value()) return false;
  const std::uint32_t group = first->tag >> 16U;
  if (group != 0x0002 && group != 0x0008) return false;
  // Elements of group 0002 are always explicit.
  if (group == 0x0002 && !is_explicit) return false;
  const auto second = elementAt(bytes, first->value + first->size, is_explicit);
  return second.has_value() && second->tag > first->tag && second->tag >> 16U <= 0x0010;
}

/// Returns true for a data set in big-endian byte order without preamble. Such a file does not
/// state its transfer syntax.
bool beginsAsBigEndian(std::string_view bytes) {
  std::string swapped(bytes.substr(0, 8));
  if (swapped.size() < 8) return false;
  for (const std::size_t at : {0U, 2U, 6U}) std::swap(swapped[at], swapped[at + 1]);
  swapped.append(4, '\0');
  const auto first = elementAt(swapped, 0, true);
  return first.has_value() && first->tag >> 16U == 0x0008;
}

struct SyntaxField {
  std::size_t at = 0;
  std::string text;
  std::size_t data_set = 0;
};

SyntaxField syntaxOf(std::string_view bytes) {
  SyntaxField field;
  field.data_set = bytes.substr(std::min(kPreamble, bytes.size()), 4) == "DICM" ? kPrefix : 0;
  while (const auto head = elementAt(bytes, field.data_set, true)) {
    if (head->tag >> 16U != 0x0002 || head->value + head->size > bytes.size()) break;
    if (head->tag == 0x00020010) {
      field.at = head->value;
      field.text = bytes.substr(head->value, head->size);
    }
    field.data_set = head->value + head->size;
  }
  return field;
}

bool writeAll(int to, const char* data, std::size_t size) {
  while (size > 0) {
    const ssize_t written = ::write(to, data, size);
    if (written <= 0) return false;
    data += written;
    size -= static_cast<std::size_t>(written);
  }
  return true;
}

struct InflateEnd {
  z_stream* stream;
  explicit InflateEnd(z_stream* s) : stream(s) {}
  InflateEnd(const InflateEnd&) = delete;
  InflateEnd& operator=(const InflateEnd&) = delete;
  ~InflateEnd() { inflateEnd(stream); }
};

/// Inflates the rest of a file into the file descriptor `to`. Returns the reason of a failure; ""
/// on success.
std::string inflateInto(int to, std::istream& in) {
  // The length of an element has 32 bits, so a larger data set has no readable image.
  constexpr std::uint64_t kMost = std::uint64_t{1} << 32U;
  z_stream stream{};
  if (inflateInit2(&stream, -MAX_WBITS) != Z_OK) return kNoMemory;
  const InflateEnd end(&stream);
  std::vector<char> packed(1U << 16U);
  std::vector<char> plain(1U << 18U);
  std::uint64_t total = 0;
  for (int status = Z_OK; status != Z_STREAM_END;) {
    if (stream.avail_in == 0) {
      in.read(packed.data(), static_cast<std::streamsize>(packed.size()));
      stream.next_in = reinterpret_cast<Bytef*>(packed.data());
      stream.avail_in = static_cast<uInt>(in.gcount());
      if (stream.avail_in == 0) return "the deflated data set is truncated";
    }
    stream.next_out = reinterpret_cast<Bytef*>(plain.data());
    stream.avail_out = static_cast<uInt>(plain.size());
    status = inflate(&stream, Z_NO_FLUSH);
    if (status == Z_MEM_ERROR) return kNoMemory;
    if (status != Z_OK && status != Z_STREAM_END) return "the deflated data set is damaged";
    const std::size_t count = plain.size() - stream.avail_out;
    total += count;
    if (total > kMost) return kTooLarge;
    if (!writeAll(to, plain.data(), count)) return kNoMemory;
  }
  return "";
}

}  // namespace

bool beginsAsDicom(std::string_view bytes) {
  if (bytes.size() >= kPrefix && bytes.substr(kPreamble, 4) == "DICM") return true;
  return beginsAsDataSet(bytes, true) || beginsAsDataSet(bytes, false) || beginsAsBigEndian(bytes);
}

PlainDicom::PlainDicom(const fs::path& file) : path_(file.string()) {
  std::array<char, 4096> begin{};
  std::ifstream in(file, std::ios::binary);
  in.read(begin.data(), begin.size());
  std::string head(begin.data(), static_cast<std::size_t>(in.gcount()));
  if (!beginsAsDataSet(head, false) && beginsAsBigEndian(head)) {
    throw VolumeError(file.string(),
                      "the file has big-endian values, but states no transfer syntax",
                      "convert it to little endian, for example with dcmconv +te");
  }
  const SyntaxField syntax = syntaxOf(head);
  if (syntax.text.substr(0, syntax.text.find('\0')) != kDeflatedSyntax) return;
  // The copy states the plain transfer syntax, padded to the old length.
  head.resize(syntax.data_set);
  std::fill_n(head.begin() + static_cast<std::ptrdiff_t>(syntax.at), syntax.text.size(), '\0');
  std::copy(kPlainSyntax.begin(), kPlainSyntax.end(),
            head.begin() + static_cast<std::ptrdiff_t>(syntax.at));
  in.clear();
  in.seekg(static_cast<std::streamoff>(syntax.data_set));
  memory_ = Descriptor(::memfd_create("palpate-dicom", MFD_CLOEXEC));
  const int memory = memory_.get();
  std::string defect = memory >= 0 ? kNoMemory
                                   : fmt::format("the inflated data set gets no memory file ({})",
                                                 std::strerror(errno));
  if (memory >= 0 && writeAll(memory, head.data(), head.size())) {
    defect = inflateInto(memory, in);
  }
  if (!defect.empty()) {
    throw VolumeError(file.string(), defect,
                      defect == kNoMemory ? "inflate it on the disk with dcmconv +te, or end other "
                                            "programs"
                      : defect == kTooLarge ? "export a smaller part"
                      : memory < 0          ? "end other programs"
                                            : "copy or export the file again");
  }
  path_ = fmt::format("/proc/self/fd/{}", memory);
}

bool decodeBits(std::string_view item, std::size_t pixels, unsigned char* out) {
  constexpr std::size_t kHeader = 64;
  const std::size_t first = numberAt(item, 4, 4);
  if (item.size() < kHeader || numberAt(item, 0, 4) != 1 || first < kHeader) return false;
  // PackBits: a count >= 0 precedes count + 1 bytes; a negative count precedes one byte that occurs
  // 1 - count times; -128 has no effect.
  std::vector<unsigned char> bytes;
  for (std::size_t at = first; at < item.size() && bytes.size() < pixels;) {
    const auto count = static_cast<signed char>(item[at++]);
    if (count == -128) continue;
    const std::size_t taken = count >= 0 ? static_cast<std::size_t>(count) + 1 : 1;
    if (at + taken > item.size()) break;
    if (count >= 0) {
      bytes.insert(bytes.end(), item.begin() + static_cast<std::ptrdiff_t>(at),
                   item.begin() + static_cast<std::ptrdiff_t>(at + taken));
    } else {
      bytes.insert(bytes.end(), static_cast<std::size_t>(1 - count),
                   static_cast<unsigned char>(item[at]));
    }
    at += taken;
  }
  // A frame has one bit per pixel, the lowest first, or one byte per pixel, and then padding.
  const std::size_t packed = (pixels + 7) / 8;
  if (bytes.size() >= pixels) {
    for (std::size_t i = 0; i < pixels; ++i) out[i] = bytes[i] != 0 ? 1 : 0;
    return true;
  }
  if (bytes.size() < packed || bytes.size() > packed + 1) return false;
  for (std::size_t i = 0; i < pixels; ++i) {
    out[i] = static_cast<unsigned char>((bytes[i / 8] >> (i % 8)) & 1U);
  }
  return true;
}

}  // namespace palpate::importer
