#include "palpate/scenes/library/frames.h"

#include <algorithm>
#include <cctype>
#include <map>
#include <optional>
#include <system_error>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/samplers/bricks/bricks.h"
#include "palpate/scenes/library/brick_places.h"

namespace palpate {
namespace {

namespace fs = std::filesystem;

/// A file name with a number, such as frame_%03d.vdb.
struct Pattern {
  std::string before;
  std::string after;
  /// Smallest number of digits, filled with leading zeros; 0: no leading zeros.
  std::size_t digits = 0;

  [[nodiscard]] std::optional<long> numberIn(const std::string& name) const {
    constexpr std::size_t kMostDigits = 9;
    if (name.size() <= before.size() + after.size()) return std::nullopt;
    if (name.compare(0, before.size(), before) != 0) return std::nullopt;
    if (name.compare(name.size() - after.size(), after.size(), after) != 0) return std::nullopt;
    const std::string number =
        name.substr(before.size(), name.size() - before.size() - after.size());
    if (number.size() > kMostDigits || number.size() < digits) return std::nullopt;
    if (!std::all_of(number.begin(), number.end(),
                     [](unsigned char c) { return std::isdigit(c) != 0; })) {
      return std::nullopt;
    }
    // The number of leading zeros must match: frame_007 and frame_7 are different files.
    if (number.size() > std::max<std::size_t>(digits, 1) && number.front() == '0') {
      return std::nullopt;
    }
    return std::stol(number);
  }
  [[nodiscard]] std::string nameOf(long number) const {
    return before + fmt::format("{:0{}}", number, digits) + after;
  }
};

std::optional<Pattern> patternOf(const fs::path& file) {
  const std::string name = file.filename().string();
  const std::size_t at = name.find('%');
  if (at == std::string::npos) return std::nullopt;
  std::size_t end = at + 1;
  while (end < name.size() && std::isdigit(static_cast<unsigned char>(name[end])) != 0) ++end;
  if (end >= name.size() || name[end] != 'd') return std::nullopt;
  const std::string width = name.substr(at + 1, end - at - 1);
  if (width.size() > 2 || (!width.empty() && width.front() != '0')) return std::nullopt;
  Pattern out{name.substr(0, at), name.substr(end + 1), 0};
  if (!width.empty()) out.digits = static_cast<std::size_t>(std::stoi(width));
  if (out.after.find('%') != std::string::npos) return std::nullopt;
  return out;
}

std::map<long, fs::path> filesOf(const fs::path& file, const Pattern& pattern,
                                 std::error_code& error) {
  std::map<long, fs::path> files;
  const fs::path folder = file.has_parent_path() ? file.parent_path() : fs::path(".");
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    const auto number = pattern.numberIn(entry->path().filename().string());
    if (number) files[*number] = file.parent_path() / entry->path().filename();
  }
  return files;
}

}  // namespace

bool isPattern(const fs::path& file) {
  return patternOf(file).has_value();
}

std::vector<VolumeRequest> framesOf(const VolumeSpec& volume) {
  const VolumeRequest like{volume.file, volume.grid, volume.non_finite, volume.smooth};
  std::vector<VolumeRequest> frames;
  if (const auto pattern = patternOf(volume.file)) {
    std::error_code error;
    const std::map<long, fs::path> files = filesOf(volume.file, *pattern, error);
    if (files.empty()) {
      const std::string folder =
          volume.file.has_parent_path() ? volume.file.parent_path().string() : ".";
      if (error == std::errc::no_such_file_or_directory || error == std::errc::not_a_directory) {
        throw VolumeError(folder, "no such folder", "check the path");
      }
      if (error) {
        throw VolumeError(folder, "the folder cannot be read (" + error.message() + ")",
                          "check its permissions");
      }
      throw VolumeError(volume.file.string(), "the folder has no frame with this name",
                        "put numbered frames there, such as " + pattern->nameOf(1));
    }
    long next = files.begin()->first;
    for (const auto& [number, file] : files) {
      if (number != next) {
        throw VolumeError(
            (volume.file.parent_path() / pattern->nameOf(next)).string(),
            fmt::format("the frame is missing, but {} exists", file.filename().string()),
            "copy this frame too; if none is missing, number the frames without a gap");
      }
      ++next;
      frames.push_back(like);
      frames.back().file = file;
    }
    return frames;
  }
  const std::vector<std::string> names = gridNames(volume.file);
  const auto plain = [](const std::string& name) { return name.substr(0, name.rfind('[')); };
  for (const std::string& name : names) {
    if (volume.grid.empty() && plain(name) != plain(names.front())) {
      throw VolumeError(
          volume.file.string(),
          "the file has grids of several names: " + plain(names.front()) + ", " + plain(name),
          "select one by \"grid\"");
    }
    const bool one = volume.grid.empty() || name == volume.grid;
    const bool of_many = name.size() > volume.grid.size() + 2 &&
                         name.compare(0, volume.grid.size() + 1, volume.grid + "[") == 0;
    if (!one && !of_many) continue;
    frames.push_back(like);
    frames.back().grid = name;
  }
  // If no grid has this name, requests it as a single grid, so that loading reports the error.
  if (frames.empty()) frames.push_back(like);
  return frames;
}

std::vector<fs::path> filesOf(const VolumeSpec& volume) {
  if (volume.file.empty()) return {};
  if (isRemote(volume.file)) return {};
  if (isBricks(volume.file)) return {brickManifestFile(volume.file)};
  const auto pattern = patternOf(volume.file);
  if (!pattern) return {volume.file};
  std::vector<fs::path> files;
  std::error_code ignored;
  for (auto& [number, file] : filesOf(volume.file, *pattern, ignored)) files.push_back(file);
  return files;
}

}  // namespace palpate
