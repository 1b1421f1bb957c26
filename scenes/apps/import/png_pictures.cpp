/// Reads PNG files by libpng. VTK 9.1's reader crashes if a file is truncated.
#include <bit>
#include <cstdio>
#include <new>
#include <png.h>
#include <string>
#include <system_error>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/pictures.h"

namespace palpate::importer {
namespace {

constexpr const char* kCopyPng = "copy or export the file again";

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};

class PngPicture final : public Pictures {
 public:
  explicit PngPicture(std::filesystem::path path)
      : path_(std::move(path)), file_(std::fopen(path_.c_str(), "rb")) {
    if (file_ == nullptr) {
      throw VolumeError(path_.string(), "the file cannot be read", "check the permissions");
    }
    png_ = png_create_read_struct(PNG_LIBPNG_VER_STRING, this, hearError, hearWarning);
    info_ = png_ == nullptr ? nullptr : png_create_info_struct(png_);
    if (info_ == nullptr) {
      png_destroy_read_struct(&png_, nullptr, nullptr);
      throw std::bad_alloc();
    }
    try {
      readHeader();
    } catch (...) {
      png_destroy_read_struct(&png_, &info_, nullptr);
      throw;
    }
  }
  PngPicture(const PngPicture&) = delete;
  PngPicture& operator=(const PngPicture&) = delete;
  ~PngPicture() override { png_destroy_read_struct(&png_, &info_, nullptr); }

  const std::vector<PictureFormat>& formats() const override { return formats_; }

  void read(std::size_t /*index*/, void* to) override {
    const PictureFormat& format = formats_.front();
    const std::size_t bytes =
        static_cast<std::size_t>(format.width) * (format.type == Type::kUint16 ? 2 : 1);
    std::vector<png_bytep> rows(static_cast<std::size_t>(format.height));
    for (std::size_t row = 0; row < rows.size(); ++row) {
      rows[row] = static_cast<png_bytep>(to) + row * bytes;
    }
    png_bytepp first = rows.data();
    attempt([this, first] {
      png_read_image(png_, first);
      png_read_end(png_, nullptr);  // verifies the checksums of the last pixels
    });
  }

 private:
  /// libpng requires that this function does not return.
  [[noreturn]] static void hearError(png_structp png, png_const_charp message) {
    auto& self = *static_cast<PngPicture*>(png_get_error_ptr(png));
    std::snprintf(self.message_, sizeof self.message_, "%s", message);
    png_longjmp(png, 1);
  }
  static void hearWarning(png_structp /*png*/, png_const_charp /*message*/) {}

  /// Calls libpng. Throws VolumeError if it reports an error. libpng then jumps out of `task`,
  /// which must not own objects with destructors.
  template <class Task>
  void attempt(const Task& task) {
    if (setjmp(png_jmpbuf(png_)) == 0) {  // NOLINT(cert-err52-cpp): libpng has no other way
      task();
      return;
    }
    throw VolumeError(path_.string(), fmt::format("the PNG file is damaged ({})", message_),
                      kCopyPng);
  }

  void readHeader() {
    attempt([this] {
      png_init_io(png_, file_.get());
      png_read_info(png_, info_);
    });
    const unsigned width = png_get_image_width(png_, info_);
    const unsigned height = png_get_image_height(png_, info_);
    const int bits = png_get_bit_depth(png_, info_);
    if (png_get_color_type(png_, info_) != PNG_COLOR_TYPE_GRAY) refuseColours(path_, "the picture");
    std::error_code error;
    const auto held = static_cast<double>(std::filesystem::file_size(path_, error));
    checkHeld(path_, path_, error ? 0.0 : held,
              leastDeflated(0.125 * bits * static_cast<double>(width) * height));
    attempt([this, bits] {
      if (bits < 8) png_set_packing(png_);
      if (bits == 16 && std::endian::native == std::endian::little) png_set_swap(png_);
      png_set_interlace_handling(png_);
      png_read_update_info(png_, info_);
    });
    formats_.push_back({static_cast<int>(width), static_cast<int>(height),
                        bits == 16 ? Type::kUint16 : Type::kUint8});
  }

  std::filesystem::path path_;
  std::unique_ptr<std::FILE, CloseFile> file_;
  png_structp png_ = nullptr;
  png_infop info_ = nullptr;
  std::vector<PictureFormat> formats_;
  char message_[120] = "";
};

}  // namespace

std::unique_ptr<Pictures> openPng(const std::filesystem::path& file) {
  return std::make_unique<PngPicture>(file);
}

}  // namespace palpate::importer
