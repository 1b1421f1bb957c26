#include "palpate/scenes/apps/import/netcdf_size.h"

#include <algorithm>
#include <array>
#include <fstream>
#include <vector>

namespace palpate::importer {
namespace {

/// Reads big-endian numbers. `ok` becomes false at the end of the file, or for numbers that no
/// header can have.
class Header {
 public:
  explicit Header(std::istream& in, int version) : in_(in), version_(version) {}

  std::uint64_t number(int bytes) {
    std::uint64_t out = 0;
    for (int b = 0; b < bytes; ++b) {
      const int c = in_.get();
      if (c < 0) ok = false;
      out = out << 8U | static_cast<unsigned>(c & 0xff);
    }
    return out;
  }
  /// Reads a count or a length: 8 bytes in CDF-5, 4 bytes in older versions.
  std::uint64_t count() { return number(version_ == 5 ? 8 : 4); }
  std::uint64_t offset() { return number(version_ == 1 ? 4 : 8); }
  void skip(std::uint64_t bytes) {
    constexpr std::uint64_t kLongest = 1U << 28U;  // [bytes]: longer than any header
    if (bytes > kLongest) {
      ok = false;
      return;
    }
    in_.ignore(static_cast<std::streamsize>((bytes + 3) / 4 * 4));
    ok = ok && !in_.eof();
  }
  std::uint64_t list() {
    (void)number(4);
    const std::uint64_t elements = count();
    if (elements > 1U << 20U) ok = false;
    return ok ? elements : 0;
  }

  bool ok = true;

 private:
  std::istream& in_;
  int version_;
};

std::uint64_t widthOf(std::uint64_t type) {
  constexpr std::array<std::uint64_t, 12> kWidths{0, 1, 1, 2, 4, 4, 8, 1, 2, 4, 8, 8};
  return type < kWidths.size() ? kWidths[type] : 0;
}

void skipAttributes(Header& header) {
  const std::uint64_t attributes = header.list();
  for (std::uint64_t a = 0; a < attributes && header.ok; ++a) {
    header.skip(header.count());
    const std::uint64_t width = widthOf(header.number(4));
    header.skip(width * header.count());
  }
}

}  // namespace

std::optional<std::uint64_t> netcdfSize(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::array<char, 4> magic{};
  in.read(magic.data(), magic.size());
  if (!in || magic[0] != 'C' || magic[1] != 'D' || magic[2] != 'F') return std::nullopt;
  if (magic[3] != 1 && magic[3] != 2 && magic[3] != 5) return std::nullopt;
  Header header(in, magic[3]);

  const std::uint64_t records = header.count();
  std::vector<std::uint64_t> lengths;
  const std::uint64_t dimensions = header.list();
  for (std::uint64_t d = 0; d < dimensions && header.ok; ++d) {
    header.skip(header.count());
    lengths.push_back(header.count());
  }
  skipAttributes(header);

  std::uint64_t end = 0;
  std::uint64_t record = 0;        // size of one record [bytes]
  std::uint64_t record_begin = 0;  // offset of the first record [bytes]
  std::uint64_t last_part = 0;     // size of the last variable in a record, without padding [bytes]
  std::uint64_t parts = 0;
  const std::uint64_t variables = header.list();
  for (std::uint64_t v = 0; v < variables && header.ok; ++v) {
    header.skip(header.count());
    const std::uint64_t rank = header.count();
    if (rank > lengths.size()) return std::nullopt;
    bool is_record = false;
    std::uint64_t values = 1;
    for (std::uint64_t d = 0; d < rank && header.ok; ++d) {
      const std::uint64_t dimension = header.count();
      if (dimension >= lengths.size()) return std::nullopt;
      if (d == 0 && lengths[dimension] == 0) {
        is_record = true;  // the dimension of records has length 0
      } else {
        values *= lengths[dimension];
      }
    }
    skipAttributes(header);
    const std::uint64_t bytes = values * widthOf(header.number(4));
    (void)header.count();  // skips the stated size, which can be too small for large variables
    const std::uint64_t begin = header.offset();
    if (!is_record) {
      end = std::max(end, begin + bytes);
      continue;
    }
    if (parts++ == 0) record_begin = begin;
    record_begin = std::min(record_begin, begin);
    record += (bytes + 3) / 4 * 4;
    last_part = bytes;
  }
  if (!header.ok) return std::nullopt;
  constexpr std::uint64_t kStreaming = 0xffffffffU;  // the number of records is unknown
  if (parts > 0 && records > 0 && records != kStreaming) {
    // The records of a single record variable have no padding.
    const std::uint64_t padding = parts == 1 ? record - last_part : 0;
    const std::uint64_t all = records * (record - padding);
    end = std::max(end, record_begin + all - (parts == 1 ? 0 : (4 - last_part % 4) % 4));
  }
  return end;
}

}  // namespace palpate::importer
