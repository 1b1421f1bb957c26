/// Reads slices as pictures: a folder of PNG or TIFF files, or a TIFF with several pages.
#include <algorithm>
#include <array>
#include <cstddef>
#include <system_error>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/pictures.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/slice_names.h"
#include "palpate/scenes/apps/import/slice_spacing.h"

namespace palpate::importer {
namespace {

namespace fs = std::filesystem;

std::unique_ptr<Pictures> openPictures(const fs::path& file) {
  return pictureKind(firstBytesOf(file)) == PictureKind::kPng ? openPng(file) : openTiff(file);
}

std::string describeFormat(const PictureFormat& format) {
  constexpr std::array<const char*, 10> kTypes{"int8",   "uint8", "int16",  "uint16",  "int32",
                                               "uint32", "int64", "uint64", "float32", "float64"};
  return fmt::format("{} x {} {}", format.width, format.height,
                     kTypes[static_cast<std::size_t>(format.type)]);
}

/// A slice: a page of a file.
struct SlicePage {
  fs::path file;
  std::size_t page = 0;
};

struct SliceStack {
  std::vector<SlicePage> slices;
  PictureFormat format;
  StatedStack stated;
  std::vector<std::string> notes;
};

/// Throws VolumeError unless a slice has the format of the first slice. Both have names.
void checkAlike(const fs::path& subject, const PictureFormat& first, const std::string& first_name,
                const PictureFormat& other, const std::string& other_name) {
  if (first == other) return;
  throw VolumeError(subject.string(),
                    fmt::format("{} is {}, but {} is {}", other_name, describeFormat(other),
                                first_name, describeFormat(first)),
                    "give slices of equal size and number type");
}

SliceStack stackOfFolder(const fs::path& folder) {
  std::vector<FolderFile> files;
  std::error_code error;
  fs::directory_iterator entry(folder, error);
  for (; !error && entry != fs::directory_iterator(); entry.increment(error)) {
    std::error_code ignored;
    if (!entry->is_regular_file(ignored)) continue;
    files.push_back({entry->path().filename().string(), pictureKind(firstBytesOf(entry->path()))});
  }
  if (error) {
    throw VolumeError(folder.string(),
                      fmt::format("the folder cannot be read ({})", error.message()),
                      "check the folder and its permissions");
  }
  SliceNames names = orderSlices(folder.string(), std::move(files));
  SliceStack out;
  out.notes = std::move(names.notes);
  for (const std::string& name : names.slices) {
    const fs::path file = folder / name;
    const std::unique_ptr<Pictures> pictures = openPictures(file);
    const std::vector<PictureFormat>& formats = pictures->formats();
    if (formats.size() != 1) {
      throw VolumeError(file.string(),
                        fmt::format("the file has {} pages, but each file of a folder must be one "
                                    "slice",
                                    formats.size()),
                        "import the file itself, without the folder");
    }
    if (out.slices.empty()) {
      out.format = formats.front();
      out.stated = pictures->stated();
      for (std::string& note : pictures->notes()) out.notes.push_back(std::move(note));
    }
    checkAlike(folder, out.format, names.slices.front(), formats.front(), name);
    out.slices.push_back({file, 0});
  }
  return out;
}

/// Throws VolumeError unless the file's description agrees with its pages.
void checkPages(const fs::path& file, const StatedStack& stated, std::size_t pages) {
  if (stated.channels > 1.0 || stated.times > 1.0) {
    throw VolumeError(file.string(),
                      fmt::format("the file has {:.0f} channels and {:.0f} times, not one volume",
                                  std::max(stated.channels, 1.0), std::max(stated.times, 1.0)),
                      "save one channel at one time, for example with Fiji's Image > Duplicate");
  }
  const auto count = static_cast<double>(pages);
  if (stated.pictures > 0.0 && stated.pictures != count) {
    throw VolumeError(
        file.string(),
        fmt::format("the description states {:.0f} pictures, but the file has {} pages",
                    stated.pictures, pages),
        pages == 1 ? "save an image sequence, and import its folder (ImageJ writes stacks above 4 "
                     "GB without pages)"
                   : "copy or export the file again");
  }
  if (pages > 1) return;
  throw VolumeError(file.string(), "the TIFF file has one picture, which is not a volume",
                    "give the folder of all slices, or a TIFF file with several pages");
}

SliceStack stackOfPages(const fs::path& file) {
  const std::unique_ptr<Pictures> pictures = openTiff(file);
  const std::vector<PictureFormat>& formats = pictures->formats();
  SliceStack out;
  out.format = formats.front();
  out.stated = pictures->stated();
  out.notes = pictures->notes();
  checkPages(file, out.stated, formats.size());
  for (std::size_t page = 0; page < formats.size(); ++page) {
    checkAlike(file, out.format, "page 1", formats[page], fmt::format("page {}", page + 1));
    out.slices.push_back({file, page});
  }
  return out;
}

/// Returns the spacing of --spacing, or else that of the files, with a note. Throws VolumeError if
/// neither is complete.
Spacing chooseSpacing(const Request& request, const StatedStack& stated,
                      std::vector<std::string>& notes) {
  if (request.spacing) return *request.spacing;
  const Spacing& spacing = stated.spacing;
  const Vec3& edges = spacing.edges;
  if (edges.minCoeff() > 0.0) {
    notes.push_back(
        fmt::format("the spacing is {:.6g} x {:.6g} x {:.6g} {}, as {} states: "
                    "--spacing replaces it",
                    edges.x(), edges.y(), edges.z(), spacing.unit, stated.source));
    return spacing;
  }
  const bool has_pixels = edges.x() > 0.0 && edges.y() > 0.0;
  throw VolumeError(
      request.file.string(),
      has_pixels ? fmt::format("{} gives pixels of {:.6g} x {:.6g} {}, but no file states the "
                               "distance of the slices",
                               stated.source, edges.x(), edges.y(), spacing.unit)
                 : "the pictures do not state the spacing of the voxels",
      has_pixels ? fmt::format("add --spacing {:.6g},{:.6g},DISTANCE{}", edges.x(), edges.y(),
                               spacing.unit)
                 : "add the edges of a voxel along x, y and z, as in --spacing 10,10,20um");
}

class PictureReader final : public Reader {
 public:
  PictureReader(Request request, SliceStack stack)
      : request_(std::move(request)),
        stack_(std::move(stack)),
        spacing_(chooseSpacing(request_, stack_.stated, stack_.notes)) {}

  Content read(std::size_t /*step*/) override {
    Piece image;
    image.size = {stack_.format.width, stack_.format.height,
                  static_cast<int>(stack_.slices.size())};
    image.file_from_index.linear = spacing_.edges.asDiagonal();
    (void)bytesOf(request_.file, {image.size.begin(), image.size.end()},
                  static_cast<double>(Values(stack_.format.type, 1, 0).bytesEach()));
    const Slab slab = slicesToRead(request_, image);
    const std::size_t plane =
        static_cast<std::size_t>(image.size[0]) * static_cast<std::size_t>(image.size[1]);
    const Values values(stack_.format.type, 1, plane * static_cast<std::size_t>(slab.count));
    readSlab(slab, values, plane * values.bytesEach());

    Content content;
    image.arrays.push_back({"density", values, "", "", false});
    content.pieces.push_back(std::move(image));
    content.length_unit = spacing_.unit;
    content.notes = stack_.notes;
    return content;
  }

 private:
  void readSlab(const Slab& slab, const Values& values, std::size_t bytes) const {
    std::unique_ptr<Pictures> pictures;
    fs::path open;
    for (int k = slab.first; k < slab.end(); ++k) {
      const SlicePage& slice = stack_.slices[static_cast<std::size_t>(k)];
      if (pictures == nullptr || open != slice.file) {
        pictures = openPictures(slice.file);
        open = slice.file;
      }
      const std::vector<PictureFormat>& formats = pictures->formats();
      if (slice.page >= formats.size() || formats[slice.page] != stack_.format) {
        throw VolumeError(slice.file.string(), "the file changed during the import",
                          "repeat the import when no program writes the file");
      }
      const auto done = static_cast<std::size_t>(k - slab.first);
      pictures->read(slice.page, values.as<char>() + done * bytes);
      if (request_.progress) request_.progress(static_cast<double>(done + 1) / slab.count);
    }
  }

  Request request_;
  SliceStack stack_;
  Spacing spacing_;
};

}  // namespace

void refuseColours(const fs::path& file, const std::string& which) {
  throw VolumeError(
      file.string(),
      fmt::format("{} has colours, a colour map or transparency, not grey values", which),
      "convert the slices to grey, for example with Fiji's Image > Type > 16-bit");
}

std::unique_ptr<Reader> openSlices(const Request& request) {
  std::error_code error;
  SliceStack stack = fs::is_directory(request.file, error) ? stackOfFolder(request.file)
                                                           : stackOfPages(request.file);
  return std::make_unique<PictureReader>(request, std::move(stack));
}

}  // namespace palpate::importer
