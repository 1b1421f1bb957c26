/// Reads folders of Zarr version 2: OME-Zarr images, and single arrays.
#include <algorithm>
#include <array>
#include <optional>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/import/header_checks.h"
#include "palpate/scenes/apps/import/ome_zarr.h"
#include "palpate/scenes/apps/import/reader.h"
#include "palpate/scenes/apps/import/zarr_array.h"

namespace palpate::importer {
namespace {

class ZarrReader final : public Reader {
 public:
  explicit ZarrReader(const Request& request) : request_(request) {
    const std::filesystem::path& folder = request_.file;
    std::error_code error;
    nlohmann::json attributes = nlohmann::json::object();
    if (std::filesystem::exists(folder / ".zattrs", error)) {
      attributes = readZarrJson(folder / ".zattrs");
    }
    if (attributes.contains("palpate")) {
      refuse("the folder has palpate's own bricks",
             "run palpate scene on the folder, without an import");
    }
    if (attributes.contains("multiscales")) {
      openImage(attributes);
    } else if (std::filesystem::exists(folder / ".zarray", error)) {
      openArray();
    } else {
      refuse("the folder is a Zarr group without an OME-Zarr image (\"multiscales\")",
             remedyFor(folder));
    }
    checkCounts();
  }

  [[nodiscard]] std::vector<double> times() const override {
    std::vector<double> times;
    if (image_.time < 0) return times;
    const auto axis = static_cast<std::size_t>(image_.time);
    for (int i = 0; i < shape()[axis]; ++i) {
      times.push_back(level_.translation[axis] + level_.scale[axis] * i);
    }
    return times;
  }

  [[nodiscard]] std::optional<double> timeUnit() const override {
    return secondsIn(image_.time_unit);
  }

  Content read(std::size_t step) override {
    Content content;
    content.notes = notes_;
    content.length_unit = image_.unit;
    content.description = image_.name;
    Piece piece;
    // The array's axes along i, j and k: the last of the axes in space is i. They may be x, y and z
    // in any order.
    std::array<std::size_t, 3> axes = image_.space;
    std::sort(axes.begin(), axes.end(), std::greater<>());
    piece.file_from_index.linear.setZero();
    for (std::size_t a = 0; a < 3; ++a) {
      piece.size[a] = shape()[axes[a]];
      const auto d =
          std::find(image_.space.begin(), image_.space.end(), axes[a]) - image_.space.begin();
      piece.file_from_index.linear(d, static_cast<Eigen::Index>(a)) = level_.scale[axes[a]];
      piece.file_from_index.origin[d] = level_.translation[axes[a]];
    }
    const Slab slices =
        slicesToRead(request_, piece, /*is_packed=*/false, array_->layout().chunks[axes[2]]);
    ZarrBox whole{std::vector<int>(image_.axes), std::vector<int>(image_.axes, 1)};
    for (std::size_t a = 0; a < 3; ++a) whole.count[axes[a]] = piece.size[a];
    if (image_.time >= 0)
      whole.first[static_cast<std::size_t>(image_.time)] = static_cast<int>(step);
    const std::size_t checked = array_->checkedChunks();
    const std::size_t missing = array_->missingChunks();
    const std::vector<int> channels = channelsToRead();
    for (std::size_t n = 0; n < channels.size(); ++n) {
      if (image_.channel >= 0) whole.first[static_cast<std::size_t>(image_.channel)] = channels[n];
      ZarrBox part = whole;
      part.first[axes[2]] = slices.first;
      part.count[axes[2]] = slices.count;
      const Progress progress = [&](double done) {
        if (!request_.progress) return;
        request_.progress((static_cast<double>(n) + done) / static_cast<double>(channels.size()));
      };
      piece.arrays.push_back(
          {nameOf(channels[n]), array_->read(whole, part, progress), "", "", false});
    }
    if (array_->missingChunks() > missing) {
      content.notes.push_back(
          fmt::format("{} of {} chunks are missing: their voxels have the array's fill value, {}",
                      array_->missingChunks() - missing, array_->checkedChunks() - checked,
                      array_->layout().fill_text));
    }
    content.pieces.push_back(std::move(piece));
    return content;
  }

 private:
  [[noreturn]] void refuse(const std::string& why, const std::string& remedy) const {
    throw VolumeError(request_.file.string(), why, remedy);
  }

  [[nodiscard]] const std::vector<int>& shape() const { return array_->layout().shape; }

  void openImage(const nlohmann::json& attributes) {
    image_ = parseOmeImage(attributes, request_.file / ".zattrs", notes_);
    const std::size_t count = image_.levels.size();
    const std::size_t number = request_.level.value_or(0);
    if (number >= count) {
      throw Error("--level", fmt::format("the image has no level {}", number),
                  count == 1 ? "omit this option, because the image has one level"
                             : fmt::format("give 0 to {}", count - 1));
    }
    if (count > 1 && !request_.level) {
      notes_.push_back(
          fmt::format("the image has {} levels: this is the first (--level 0); --level "
                      "N reads level N, 0 to {}",
                      count, count - 1));
    }
    level_ = image_.levels[number];
    const std::filesystem::path folder = request_.file / level_.path;
    static_cast<void>(sizeOfData(request_.file / ".zattrs", folder / ".zarray", request_.follow));
    array_.emplace(request_, folder, /*has_coarser=*/number + 1 < count);
    if (shape().size() != image_.axes) {
      throw VolumeError(
          array_->header().string(),
          fmt::format("the array has {} axes, but its image has {}", shape().size(), image_.axes),
          "correct the metadata, or export the image again");
    }
  }

  void openArray() {
    array_.emplace(request_, request_.file);
    if (request_.level) {
      throw Error("--level", "the folder is a single Zarr array, which has no levels",
                  "give the folder of an OME-Zarr image, or omit this option");
    }
    if (shape().size() != 3) {
      refuse(fmt::format("the Zarr array has {} axes; palpate reads a single array with the 3 axes "
                         "z, y and x",
                         shape().size()),
             "give the folder of its OME-Zarr image, whose metadata name the axes, or export an "
             "array with 3 axes");
    }
    image_.axes = 3;
    image_.space = {2, 1, 0};
    level_.scale.assign(3, 1.0);
    level_.translation.assign(3, 0.0);
    notes_.emplace_back(
        "a single Zarr array states no spacing: its axes are read as z, y and x, and its voxels "
        "have edges of 1");
  }

  void checkCounts() const {
    constexpr int kMostChannels = 1000;
    constexpr int kMostSteps = 1'000'000;
    const auto check = [&](int axis, int most, const char* what) {
      const int count = axis < 0 ? 1 : shape()[static_cast<std::size_t>(axis)];
      if (count > most) {
        refuse(fmt::format("the image has {} {}, more than the limit of {}", count, what, most),
               "export a part of the image");
      }
    };
    check(image_.channel, kMostChannels, "channels");
    check(image_.time, kMostSteps, "time steps");
  }

  [[nodiscard]] std::string nameOf(int channel) const {
    const auto n = static_cast<std::size_t>(channel);
    if (n < image_.channels.size() && !image_.channels[n].empty()) return image_.channels[n];
    const bool one = image_.channel < 0 || shape()[static_cast<std::size_t>(image_.channel)] == 1;
    return one ? "density" : fmt::format("channel_{}", channel);
  }

  /// Returns the channels that --field names. Returns all channels without --field, or if a name is
  /// not a channel's.
  [[nodiscard]] std::vector<int> channelsToRead() const {
    const int count = image_.channel < 0 ? 1 : shape()[static_cast<std::size_t>(image_.channel)];
    std::vector<int> all;
    std::vector<int> named;
    std::vector<std::string> unknown = request_.fields;
    for (int c = 0; c < count; ++c) {
      all.push_back(c);
      const std::string name = nameOf(c);
      std::erase(unknown, name);
      const bool is_named =
          std::find(request_.fields.begin(), request_.fields.end(), name) != request_.fields.end();
      if (is_named) named.push_back(c);
    }
    return request_.fields.empty() || !unknown.empty() ? all : named;
  }

  /// Returns the remedy for a group: the folders in it that are arrays or groups.
  static std::string remedyFor(const std::filesystem::path& group) {
    std::vector<std::string> names;
    std::error_code error;
    for (std::filesystem::directory_iterator entry(group, error), end; !error && entry != end;
         entry.increment(error)) {
      std::error_code ignored;
      for (const char* file : {".zarray", ".zgroup"}) {
        if (!std::filesystem::exists(entry->path() / file, ignored)) continue;
        names.push_back(entry->path().filename().string());
        break;
      }
    }
    if (names.empty()) return "give the folder of an OME-Zarr image or of a Zarr array";
    std::sort(names.begin(), names.end());
    constexpr std::size_t kMost = 10;
    const bool more = names.size() > kMost;
    names.resize(std::min(names.size(), kMost));
    return fmt::format("give one of the folders in it: {}{}", fmt::join(names, ", "),
                       more ? ", ..." : "");
  }

  Request request_;
  OmeImage image_;
  OmeLevel level_;
  std::optional<ZarrArray> array_;
  std::vector<std::string> notes_;
};

}  // namespace

std::unique_ptr<Reader> openZarr(const Request& request) {
  return std::make_unique<ZarrReader>(request);
}

}  // namespace palpate::importer
