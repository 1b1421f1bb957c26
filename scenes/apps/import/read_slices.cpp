/// Reads slices as pictures: a folder of PNG or TIFF files, or a TIFF with several pages.
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <new>
#include <system_error>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/bricks.h"
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
  return fmt::format("{} x {} {}{}", format.width, format.height, nameOf(format.type),
                     format.is_inverted ? " with 0 as white" : "");
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
  std::uint64_t step = 1;           ///< Difference of the numbers in the names of two slices.
  std::unique_ptr<Pictures> pages;  ///< The open file of all slices; null for a folder.
  std::vector<std::string> notes;
};

/// Throws VolumeError, which names `subject`, unless a slice has the format of the first slice.
void checkAlike(const fs::path& subject, const PictureFormat& first, const std::string& first_name,
                const PictureFormat& other, const std::string& other_name) {
  if (first == other) return;
  throw VolumeError(subject.string(),
                    fmt::format("{} is {}, but {} is {}", other_name, describeFormat(other),
                                first_name, describeFormat(first)),
                    first.is_inverted == other.is_inverted
                        ? "give slices of equal size and number type"
                        : "give slices of equal size, number type and PhotometricInterpretation");
}

/// Throws VolumeError if the description in a file states several channels or times.
void checkSingle(const fs::path& file, const StatedStack& stated) {
  if (stated.channels <= 1.0 && stated.times <= 1.0) return;
  throw VolumeError(
      file.string(),
      fmt::format("the description states several volumes (channels: {:.0f}, times: {:.0f})",
                  std::max(stated.channels, 1.0), std::max(stated.times, 1.0)),
      "save one channel at one time, for example with Fiji's Image > Duplicate");
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
  out.step = names.step;
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
    }
    checkAlike(folder, out.format, names.slices.front(), formats.front(), name);
    checkSingle(file, pictures->stated());
    for (std::string& note : pictures->notes()) {
      const bool is_known = std::find(out.notes.begin(), out.notes.end(), note) != out.notes.end();
      if (!is_known) out.notes.push_back(std::move(note));
    }
    out.slices.push_back({file, 0});
  }
  const auto count = static_cast<double>(out.slices.size());
  if (out.stated.pictures > 1.0 && out.stated.pictures != count) {
    out.notes.push_back(
        fmt::format("the folder has {} slices, but {} states {:.0f} pictures: check "
                    "that none is missing",
                    out.slices.size(), names.slices.front(), out.stated.pictures));
  }
  return out;
}

/// Throws VolumeError unless the file's description agrees with its pages.
void checkPages(const fs::path& file, const StatedStack& stated, std::size_t pages) {
  checkSingle(file, stated);
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
  SliceStack out;
  out.pages = openTiff(file);
  const std::vector<PictureFormat>& formats = out.pages->formats();
  out.format = formats.front();
  out.stated = out.pages->stated();
  out.notes = out.pages->notes();
  checkPages(file, out.stated, formats.size());
  for (std::size_t page = 0; page < formats.size(); ++page) {
    checkAlike(file, out.format, "page 1", formats[page], fmt::format("page {}", page + 1));
    out.slices.push_back({file, page});
  }
  return out;
}

/// Returns the spacing of --spacing, or else that of the files, with a note. Throws VolumeError if
/// neither is complete. Without --spacing, also throws if the numbers of the slices increase by
/// more than 1, because the distance in the files may not hold.
Spacing chooseSpacing(const Request& request, SliceStack& stack) {
  if (request.spacing) {
    if (stack.step > 1) {
      stack.notes.push_back(
          fmt::format("the numbers of the slices increase by {}: the spacing along z is the "
                      "distance between two files",
                      stack.step));
    }
    return *request.spacing;
  }
  const StatedStack& stated = stack.stated;
  const Spacing& spacing = stated.spacing;
  const Vec3& edges = spacing.edges;
  if (edges.minCoeff() > 0.0 && stack.step > 1) {
    throw VolumeError(
        request.file.string(),
        fmt::format("the numbers of the slices increase by {}, so the distance of {:.6g} {} that "
                    "{} states may not be that between two files",
                    stack.step, edges.z(), spacing.unit, stated.source),
        fmt::format("add --spacing {:.6g},{:.6g},DISTANCE{} with the distance between two files",
                    edges.x(), edges.y(), spacing.unit));
  }
  if (edges.minCoeff() > 0.0) {
    stack.notes.push_back(
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
      has_pixels && !stated.from_resolution
          ? fmt::format("add --spacing {:.6g},{:.6g},DISTANCE{}", edges.x(), edges.y(),
                        spacing.unit)
          : "add the edges of a voxel along x, y and z, as in --spacing 10,10,20um");
}

class PictureReader final : public Reader {
 public:
  PictureReader(Request request, SliceStack stack)
      : request_(std::move(request)),
        stack_(std::move(stack)),
        spacing_(chooseSpacing(request_, stack_)) {}

  Content read(std::size_t /*step*/) override {
    Piece image;
    image.size = {stack_.format.width, stack_.format.height,
                  static_cast<int>(stack_.slices.size())};
    image.file_from_index.linear = spacing_.edges.asDiagonal();
    (void)bytesOf(request_.file, {image.size.begin(), image.size.end()},
                  static_cast<double>(bytesOf(stack_.format.type)));
    const Slab slab = slicesToRead(request_, image);
    const std::size_t plane =
        static_cast<std::size_t>(image.size[0]) * static_cast<std::size_t>(image.size[1]);
    Values values;
    try {
      values = Values(stack_.format.type, 1, plane * static_cast<std::size_t>(slab.count));
    } catch (const std::bad_alloc&) {
      // A brick has kBrickSide slices, so --bricks reads at least as many together.
      const bool bricks_help = !request_.slices && image.size[2] > kBrickSide;
      throw VolumeError(request_.file.string(), "the slices need more memory than is free",
                        bricks_help ? "import them with --bricks, without --voxel and --iso: then "
                                      "only a part is in memory"
                                    : "end other programs, or scale the slices down");
    }
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
    for (int k = slab.first; k < slab.end(); ++k) {
      const SlicePage& slice = stack_.slices[static_cast<std::size_t>(k)];
      // To open a file of many pages again would read the tags of all pages again.
      const std::unique_ptr<Pictures> opened =
          stack_.pages == nullptr ? openPictures(slice.file) : nullptr;
      Pictures& pictures = opened == nullptr ? *stack_.pages : *opened;
      const std::vector<PictureFormat>& formats = pictures.formats();
      if (slice.page >= formats.size() || formats[slice.page] != stack_.format) {
        throw VolumeError(slice.file.string(), "the file changed during the import",
                          "repeat the import when no program writes the file");
      }
      const auto done = static_cast<std::size_t>(k - slab.first);
      pictures.read(slice.page, values.as<char>() + done * bytes);
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
