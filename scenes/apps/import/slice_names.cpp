#include "palpate/scenes/apps/import/slice_names.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cstddef>
#include <map>
#include <string_view>
#include <tuple>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate::importer {
namespace {

constexpr const char* kSeparate = "give a folder that has one series, with one number in the names";

/// A file name with its numbers, and with "#" in the place of each number.
struct NumberedName {
  std::string name;
  std::string pattern;
  std::vector<std::uint64_t> numbers;
};

bool isDigit(char c) {
  return c >= '0' && c <= '9';
}

NumberedName numbersIn(const std::string& name) {
  constexpr std::size_t kMostDigits = 18;
  NumberedName out;
  out.name = name;
  // Digits of the extension belong to the pattern.
  const std::size_t stem = std::min(name.rfind('.'), name.size());
  for (std::size_t at = 0; at < name.size();) {
    std::size_t end = at;
    while (end < stem && isDigit(name[end])) ++end;
    if (end == at) {
      const char c = name[at++];
      const bool is_extension = at > stem;
      out.pattern +=
          is_extension ? static_cast<char>(std::tolower(static_cast<unsigned char>(c))) : c;
    } else if (end - at > kMostDigits) {
      out.pattern.append(name, at, end - at);
      at = end;
    } else {
      std::from_chars(name.data() + at, name.data() + end, out.numbers.emplace_back());
      out.pattern += '#';
      at = end;
    }
  }
  return out;
}

using NamedSeries = std::vector<NumberedName>;

/// Returns the largest series. Throws VolumeError for none, or for several of the same size.
NamedSeries largestSeries(const std::string& folder, const std::vector<FolderFile>& files) {
  // A name may itself contain "#", so the count of numbers is a part of the key.
  std::map<std::tuple<PictureKind, std::string, std::size_t>, NamedSeries> all;
  for (const FolderFile& file : files) {
    if (file.kind != PictureKind::kPng && file.kind != PictureKind::kTiff) continue;
    NumberedName one = numbersIn(file.name);
    all[{file.kind, one.pattern, one.numbers.size()}].push_back(std::move(one));
  }
  const NamedSeries* most = nullptr;
  const NamedSeries* rival = nullptr;
  for (const auto& [key, series] : all) {
    if (most != nullptr && series.size() == most->size()) rival = &series;
    if (most != nullptr && series.size() <= most->size()) continue;
    most = &series;
    rival = nullptr;
  }
  if (most == nullptr || most->size() < 2) {
    throw VolumeError(folder,
                      "the folder has no two TIFF or PNG pictures whose names differ only in a "
                      "number",
                      "number the slices of the volume, as in slice_001.tif");
  }
  if (rival != nullptr) {
    throw VolumeError(folder,
                      fmt::format("the folder has several series of {} pictures, {} and {}",
                                  most->size(), most->front().pattern, rival->front().pattern),
                      kSeparate);
  }
  return *most;
}

/// Returns the position of the number that differs between the names. Throws VolumeError if several
/// numbers differ.
std::size_t varyingNumber(const std::string& folder, const NamedSeries& series) {
  const NumberedName& first = series.front();
  std::size_t found = 0;
  std::size_t count = 0;
  const NumberedName* other = nullptr;
  for (std::size_t n = 0; n < first.numbers.size(); ++n) {
    const auto differs = std::find_if(series.begin(), series.end(), [&](const NumberedName& one) {
      return one.numbers[n] != first.numbers[n];
    });
    if (differs == series.end()) continue;
    found = n;
    other = &*differs;
    ++count;
  }
  if (count > 1) {
    throw VolumeError(folder,
                      fmt::format("the names of the pictures differ in {} numbers, such as {} and "
                                  "{}",
                                  count, first.name, other->name),
                      kSeparate);
  }
  return found;
}

/// Throws VolumeError unless the numbers of the sorted series increase by equal steps. Returns the
/// step.
std::uint64_t evenStep(const std::string& folder, const NamedSeries& series, std::size_t which) {
  std::uint64_t step = 0;
  for (std::size_t i = 1; i < series.size(); ++i) {
    const std::uint64_t gap = series[i].numbers[which] - series[i - 1].numbers[which];
    if (gap == 0) {
      throw VolumeError(folder,
                        fmt::format("two pictures have the number {}: {} and {}",
                                    series[i].numbers[which], series[i - 1].name, series[i].name),
                        "keep one of them in the folder");
    }
    step = step == 0 ? gap : std::min(step, gap);
  }
  for (std::size_t i = 1; i < series.size(); ++i) {
    const std::uint64_t gap = series[i].numbers[which] - series[i - 1].numbers[which];
    if (gap == step) continue;
    throw VolumeError(
        folder,
        fmt::format("slices are missing: after {} comes {}, but other numbers increase by {}",
                    series[i - 1].name, series[i].name, step),
        "copy or export all slices; if none is missing, number them without gaps");
  }
  return step;
}

}  // namespace

PictureKind pictureKind(const std::string& bytes) {
  const auto begins = [&](std::string_view with) { return bytes.rfind(with, 0) == 0; };
  using namespace std::string_view_literals;
  if (begins("\x89PNG"sv)) return PictureKind::kPng;
  if (begins("\xff\xd8\xff"sv)) return PictureKind::kJpeg;
  const bool is_tiff = begins("II*\0"sv) || begins("MM\0*"sv) || begins("II+\0"sv) ||
                       begins("MM\0+"sv);  // the last two are BigTIFF
  return is_tiff ? PictureKind::kTiff : PictureKind::kNone;
}

SliceNames orderSlices(const std::string& folder, std::vector<FolderFile> files) {
  std::sort(files.begin(), files.end(),
            [](const FolderFile& a, const FolderFile& b) { return a.name < b.name; });
  NamedSeries series = largestSeries(folder, files);
  const std::size_t which = varyingNumber(folder, series);
  std::stable_sort(series.begin(), series.end(),
                   [which](const NumberedName& a, const NumberedName& b) {
                     return a.numbers[which] < b.numbers[which];
                   });

  SliceNames out;
  out.step = evenStep(folder, series, which);
  for (const NumberedName& one : series) out.slices.push_back(one.name);
  if (series.size() == files.size()) return out;
  std::vector<std::string> kept = out.slices;
  std::sort(kept.begin(), kept.end());
  const auto ignored = std::find_if(files.begin(), files.end(), [&](const FolderFile& file) {
    return !std::binary_search(kept.begin(), kept.end(), file.name);
  });
  out.notes.push_back(
      fmt::format("ignored {} of {} files, which are not slices of this series, such as {}",
                  files.size() - series.size(), files.size(), ignored->name));
  return out;
}

}  // namespace palpate::importer
