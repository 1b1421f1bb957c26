/// Reads TIFF files by libtiff. VTK 9.1's reader hides the tags, reads doubles as colours, and
/// returns wrong values for damaged data and for pages of unlike size.
#include <algorithm>
#include <array>
#include <cctype>
#include <cstdarg>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <limits>
#include <new>
#include <string>
#include <system_error>
#include <tiffio.h>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/pictures.h"

namespace palpate::importer {
namespace {

constexpr const char* kCopyTiff = "copy or export the file again";

/// Returns the largest ratio of pixels to stored bytes; 0 for a compression that is not read.
double mostRatio(int compression) {
  switch (compression) {
    case COMPRESSION_NONE:
      return 1.0;
    case COMPRESSION_PACKBITS:
      return 64.0;  // 128 equal bytes take 2
    case COMPRESSION_LZW:
      return 4096.0;  // a code of 12 bits stands for at most 4096 bytes
    case COMPRESSION_ADOBE_DEFLATE:
    case COMPRESSION_DEFLATE:
      return 1040.0;
    default:
      return 0.0;
  }
}

/// First error that libtiff reports. A loop of pages counts as an error, not as their end.
struct TiffErrors {
  std::array<char, 160> first{};

  static int hear(TIFF* /*tiff*/, void* self, const char* /*where*/, const char* format,
                  va_list words) {
    auto& text = static_cast<TiffErrors*>(self)->first;
    if (text[0] != '\0') return 1;
    std::vsnprintf(text.data(), text.size(), format, words);
    for (char& c : text) {
      if (c != '\0' && std::isprint(static_cast<unsigned char>(c)) == 0) c = '?';
    }
    return 1;  // libtiff then prints nothing
  }
  static int hearWarning(TIFF* tiff, void* self, const char* where, const char* format,
                         va_list words) {
    return std::strstr(format, "loop") == nullptr ? 1 : hear(tiff, self, where, format, words);
  }
};

struct CloseTiff {
  void operator()(TIFF* tiff) const { TIFFClose(tiff); }
};
using TiffHandle = std::unique_ptr<TIFF, CloseTiff>;

TiffHandle openHandle(const std::filesystem::path& file, TiffErrors& errors) {
  TIFFOpenOptions* options = TIFFOpenOptionsAlloc();
  if (options == nullptr) throw std::bad_alloc();
  TIFFOpenOptionsSetErrorHandlerExtR(options, TiffErrors::hear, &errors);
  TIFFOpenOptionsSetWarningHandlerExtR(options, TiffErrors::hearWarning, &errors);
  TiffHandle handle(TIFFOpenExt(file.c_str(), "rm", options));  // m: no memory map
  TIFFOpenOptionsFree(options);
  return handle;
}

struct Page {
  PictureFormat format;
  std::uint64_t offset = 0;  ///< Place of the page's tags in the file.
  int bits = 0;              ///< Bits per pixel: 1, 8, 16, 32 or 64.
};

template <class T>
void invertNumbers(T* values, std::size_t count) {
  for (std::size_t i = 0; i < count; ++i) {
    values[i] = static_cast<T>(std::numeric_limits<T>::max() - values[i]);
  }
}

void invertValues(Type type, void* data, std::size_t count) {
  switch (type) {
    case Type::kUint8:
      return invertNumbers(static_cast<std::uint8_t*>(data), count);
    case Type::kUint16:
      return invertNumbers(static_cast<std::uint16_t*>(data), count);
    case Type::kUint32:
      return invertNumbers(static_cast<std::uint32_t*>(data), count);
    case Type::kUint64:
      return invertNumbers(static_cast<std::uint64_t*>(data), count);
    default:
      return;
  }
}

class TiffPictures final : public Pictures {
 public:
  explicit TiffPictures(std::filesystem::path path) : path_(std::move(path)) {
    std::error_code error;
    held_ = static_cast<double>(std::filesystem::file_size(path_, error));
    if (error) throw VolumeError(path_.string(), "the file cannot be read", "check its path");
    tiff_ = openHandle(path_, errors_);
    if (tiff_ == nullptr) refuseDamage();
    do {
      readPage();
      checkErrors();
    } while (TIFFReadDirectory(tiff_.get()) != 0);
    checkErrors();
    checkLastLink();
    if (pages_.empty()) {
      throw VolumeError(path_.string(), "the TIFF file has only previews and masks",
                        "export the pictures themselves");
    }
  }

  const std::vector<PictureFormat>& formats() const override { return formats_; }
  StatedStack stated() const override { return stated_; }

  std::vector<std::string> notes() const override {
    std::vector<std::string> notes;
    if (skipped_ > 0) {
      notes.push_back(
          fmt::format("skipped {} pages that are previews or masks of other pages", skipped_));
    }
    const auto is_inverted = [](const PictureFormat& format) { return format.is_inverted; };
    if (std::any_of(formats_.begin(), formats_.end(), is_inverted)) {
      notes.emplace_back(
          "0 is white in the file (PhotometricInterpretation): the values are inverted, so that a "
          "larger value is brighter");
    }
    return notes;
  }

  void read(std::size_t index, void* to) override {
    const Page& page = pages_.at(index);
    if (TIFFSetSubDirectory(tiff_.get(), page.offset) == 0) refuseDamage();
    const std::size_t row = rowBytes(page);
    const std::size_t count =
        static_cast<std::size_t>(page.format.width) * static_cast<std::size_t>(page.format.height);
    std::vector<unsigned char> packed;
    if (page.bits == 1) packed.resize(row * static_cast<std::size_t>(page.format.height));
    auto* rows = page.bits == 1 ? packed.data() : static_cast<unsigned char*>(to);
    if (TIFFIsTiled(tiff_.get()) != 0) {
      readTiles(page, rows);
    } else {
      readStrips(page, rows);
    }
    checkErrors();
    if (page.bits == 1) {
      const auto width = static_cast<std::size_t>(page.format.width);
      auto* values = static_cast<unsigned char*>(to);
      const unsigned flip = page.format.is_inverted ? 1U : 0U;
      for (std::size_t i = 0; i < count; ++i) {
        const unsigned byte = packed[i / width * row + i % width / 8];
        values[i] = static_cast<unsigned char>((byte >> (7 - i % width % 8) & 1U) ^ flip);
      }
    } else if (page.format.is_inverted) {
      invertValues(page.format.type, to, count);
    }
  }

 private:
  [[noreturn]] void refuse(const std::string& why, const std::string& remedy) const {
    throw VolumeError(path_.string(), why, remedy);
  }
  [[noreturn]] void refuseDamage() const {
    const std::string said = errors_.first.data();
    refuse(said.empty() ? "the TIFF file is damaged"
                        : fmt::format("the TIFF file is damaged ({})", said),
           kCopyTiff);
  }
  void checkErrors() const {
    if (errors_.first[0] != '\0') refuseDamage();
  }

  /// Throws VolumeError if the file ends before the last page's link to a next page: libtiff then
  /// reads no more pages, and reports no error.
  void checkLastLink() const {
    const bool is_big_tiff = TIFFIsBigTIFF(tiff_.get()) != 0;
    const bool is_big_endian = TIFFIsBigEndian(tiff_.get()) != 0;
    const std::size_t width = is_big_tiff ? 8 : 2;
    std::array<unsigned char, 8> count{};
    std::ifstream in(path_, std::ios::binary);
    in.seekg(static_cast<std::streamoff>(last_));
    in.read(reinterpret_cast<char*>(count.data()), static_cast<std::streamsize>(width));
    double entries = 0.0;
    for (std::size_t i = 0; i < width; ++i) {
      entries = 256.0 * entries + count[is_big_endian ? i : width - 1 - i];
    }
    const double end = static_cast<double>(last_) + static_cast<double>(width) +
                       entries * (is_big_tiff ? 20.0 : 12.0) + (is_big_tiff ? 8.0 : 4.0);
    if (!in || end > held_) refuse("the TIFF file is truncated in its last page", kCopyTiff);
  }

  [[nodiscard]] int tag(std::uint32_t which, int otherwise) const {
    std::uint16_t value = 0;
    return TIFFGetFieldDefaulted(tiff_.get(), which, &value) != 0 ? value : otherwise;
  }

  [[nodiscard]] static std::size_t rowBytes(const Page& page) {
    return (static_cast<std::size_t>(page.format.width) * static_cast<std::size_t>(page.bits) + 7) /
           8;
  }

  /// Reads the tags of the current page, and checks them before memory is allocated for its pixels.
  void readPage() {
    last_ = TIFFCurrentDirOffset(tiff_.get());
    std::uint32_t kind = 0;
    if (TIFFGetField(tiff_.get(), TIFFTAG_SUBFILETYPE, &kind) != 0 &&
        (kind & (FILETYPE_REDUCEDIMAGE | FILETYPE_MASK)) != 0) {
      ++skipped_;
      return;
    }
    const std::string which = fmt::format("page {}", pages_.size() + 1);
    const int photometric = tag(TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_MINISBLACK);
    const bool is_grey =
        photometric == PHOTOMETRIC_MINISBLACK || photometric == PHOTOMETRIC_MINISWHITE;
    if (!is_grey || tag(TIFFTAG_SAMPLESPERPIXEL, 1) != 1) refuseColours(path_, which);
    if (tag(TIFFTAG_ORIENTATION, ORIENTATION_TOPLEFT) != ORIENTATION_TOPLEFT) {
      refuse(fmt::format("{} does not begin with the left pixel of its top row (Orientation {})",
                         which, tag(TIFFTAG_ORIENTATION, 0)),
             "export it with Orientation 1, for example with ImageMagick's -auto-orient");
    }
    Page page;
    std::uint32_t width = 0;
    std::uint32_t height = 0;
    TIFFGetField(tiff_.get(), TIFFTAG_IMAGEWIDTH, &width);
    TIFFGetField(tiff_.get(), TIFFTAG_IMAGELENGTH, &height);
    constexpr std::uint32_t kMost = std::numeric_limits<int>::max();
    if (width == 0 || height == 0 || width > kMost || height > kMost) {
      refuse(fmt::format("{} has {} x {} pixels", which, width, height), kCopyTiff);
    }
    page.format.width = static_cast<int>(width);
    page.format.height = static_cast<int>(height);
    readType(page, which);
    page.format.is_inverted = photometric == PHOTOMETRIC_MINISWHITE && isUnsigned(page.format.type);
    checkBytes(page, which);
    page.offset = last_;
    if (pages_.empty()) stated_ = statedBy(tagsOfPage());
    pages_.push_back(page);
    formats_.push_back(page.format);
  }

  static bool isUnsigned(Type type) {
    return type == Type::kUint8 || type == Type::kUint16 || type == Type::kUint32 ||
           type == Type::kUint64;
  }

  void readType(Page& page, const std::string& which) const {
    struct Stored {
      int format;
      int bits;
      Type type;
    };
    static constexpr std::array kStored{Stored{SAMPLEFORMAT_UINT, 1, Type::kUint8},
                                        Stored{SAMPLEFORMAT_UINT, 8, Type::kUint8},
                                        Stored{SAMPLEFORMAT_UINT, 16, Type::kUint16},
                                        Stored{SAMPLEFORMAT_UINT, 32, Type::kUint32},
                                        Stored{SAMPLEFORMAT_UINT, 64, Type::kUint64},
                                        Stored{SAMPLEFORMAT_INT, 8, Type::kInt8},
                                        Stored{SAMPLEFORMAT_INT, 16, Type::kInt16},
                                        Stored{SAMPLEFORMAT_INT, 32, Type::kInt32},
                                        Stored{SAMPLEFORMAT_INT, 64, Type::kInt64},
                                        Stored{SAMPLEFORMAT_IEEEFP, 32, Type::kFloat32},
                                        Stored{SAMPLEFORMAT_IEEEFP, 64, Type::kFloat64}};
    const int bits = tag(TIFFTAG_BITSPERSAMPLE, 1);
    int format = tag(TIFFTAG_SAMPLEFORMAT, SAMPLEFORMAT_UINT);
    if (format == SAMPLEFORMAT_VOID) format = SAMPLEFORMAT_UINT;
    const auto* const found = std::find_if(kStored.begin(), kStored.end(), [&](const Stored& one) {
      return one.format == format && one.bits == bits;
    });
    if (found == kStored.end()) {
      refuse(fmt::format("{} has numbers of {} bits in the sample format {}", which, bits, format),
             "export it with whole numbers of 8, 16 or 32 bits, or floats of 32 bits");
    }
    page.format.type = found->type;
    page.bits = bits;
  }

  /// Throws VolumeError unless the file can hold the pixels of this page and of those before it.
  void checkBytes(const Page& page, const std::string& which) {
    const int compression = tag(TIFFTAG_COMPRESSION, COMPRESSION_NONE);
    const double ratio = mostRatio(compression);
    if (ratio == 0.0) {
      refuse(
          fmt::format("{} has the compression {}, which palpate does not read", which, compression),
          "export it without compression, or with LZW or deflate");
    }
    const bool tiled = TIFFIsTiled(tiff_.get()) != 0;
    const std::uint32_t parts =
        tiled ? TIFFNumberOfTiles(tiff_.get()) : TIFFNumberOfStrips(tiff_.get());
    double stored = 0.0;
    for (std::uint32_t part = 0; part < parts; ++part) {
      stored += static_cast<double>(TIFFGetStrileByteCount(tiff_.get(), part));
    }
    const double pixels =
        tiled ? static_cast<double>(TIFFTileSize64(tiff_.get())) * parts
              : static_cast<double>(rowBytes(page)) * static_cast<double>(page.format.height);
    // Pages that share their pixels could state much more than the file has.
    stored_ += stored;
    if (stored_ > held_ || pixels > ratio * stored) {
      refuse(fmt::format("{} states {:.4g} bytes of pixels in {:.4g} stored bytes, but the file "
                         "has {:.0f} bytes: it is truncated, or its tags are wrong",
                         which, pixels, stored, held_),
             kCopyTiff);
    }
  }

  [[nodiscard]] TiffTags tagsOfPage() const {
    TiffTags tags;
    const char* text = nullptr;
    constexpr std::size_t kLongest = 1U << 20U;
    if (TIFFGetField(tiff_.get(), TIFFTAG_IMAGEDESCRIPTION, &text) != 0 && text != nullptr) {
      tags.description.assign(text, strnlen(text, kLongest));
    }
    float x = 0.0F;
    float y = 0.0F;
    TIFFGetField(tiff_.get(), TIFFTAG_XRESOLUTION, &x);
    TIFFGetField(tiff_.get(), TIFFTAG_YRESOLUTION, &y);
    tags.x_resolution = static_cast<double>(x);
    tags.y_resolution = static_cast<double>(y);
    tags.resolution_unit = tag(TIFFTAG_RESOLUTIONUNIT, RESUNIT_INCH);
    return tags;
  }

  void readStrips(const Page& page, unsigned char* rows) {
    std::uint32_t each = 0;
    TIFFGetFieldDefaulted(tiff_.get(), TIFFTAG_ROWSPERSTRIP, &each);
    if (each == 0) refuseDamage();
    const auto height = static_cast<std::uint32_t>(page.format.height);
    const std::size_t row = rowBytes(page);
    std::uint32_t strip = 0;
    for (std::uint32_t first = 0; first < height; ++strip) {
      const std::uint32_t count = std::min(each, height - first);
      const auto bytes = static_cast<tmsize_t>(row * count);
      if (TIFFReadEncodedStrip(tiff_.get(), strip, rows + row * first, bytes) != bytes) {
        refuseDamage();
      }
      first += count;
    }
  }

  void readTiles(const Page& page, unsigned char* rows) {
    std::uint32_t down = 0;
    TIFFGetField(tiff_.get(), TIFFTAG_TILELENGTH, &down);
    const tmsize_t stated = TIFFTileSize(tiff_.get());
    if (down == 0 || stated <= 0 || stated % down != 0) refuseDamage();
    const auto size = static_cast<std::size_t>(stated);
    const std::size_t row = rowBytes(page);
    const std::size_t tile_row = size / down;
    std::vector<unsigned char> tile(size);
    const auto height = static_cast<std::uint32_t>(page.format.height);
    std::uint32_t number = 0;
    for (std::uint32_t first = 0; first < height; first += std::min(down, height - first)) {
      for (std::size_t left = 0; left < row; left += tile_row, ++number) {
        if (TIFFReadEncodedTile(tiff_.get(), number, tile.data(), stated) != stated) {
          refuseDamage();
        }
        const std::size_t bytes = std::min(tile_row, row - left);
        for (std::uint32_t r = 0; r < std::min(down, height - first); ++r) {
          std::memcpy(rows + row * (first + r) + left, tile.data() + tile_row * r, bytes);
        }
      }
    }
  }

  std::filesystem::path path_;
  TiffErrors errors_;  ///< `tiff_` refers to this object.
  TiffHandle tiff_;
  double held_ = 0.0;       ///< Size of the file [bytes].
  std::uint64_t last_ = 0;  ///< Place of the tags that were read last.
  double stored_ = 0.0;     ///< Stored bytes of the pages so far.
  std::size_t skipped_ = 0;
  std::vector<Page> pages_;
  std::vector<PictureFormat> formats_;
  StatedStack stated_;
};

}  // namespace

std::unique_ptr<Pictures> openTiff(const std::filesystem::path& file) {
  return std::make_unique<TiffPictures>(file);
}

}  // namespace palpate::importer
