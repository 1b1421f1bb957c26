#include "palpate/scenes/apps/import/header_checks.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <system_error>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate::importer {
namespace {

constexpr double kMostBytes = 1e15;
constexpr const char* kCorrectHeader = "correct the header, or check the program that wrote it";

std::string nameOf(const std::filesystem::path& data, const std::filesystem::path& header) {
  const std::filesystem::path name = data.lexically_relative(header.parent_path());
  return name.empty() ? data.string() : name.string();
}

}  // namespace

std::string calledBy(const std::filesystem::path& header, const std::filesystem::path& data) {
  return data == header ? "the file" : nameOf(data, header);
}

double bytesOf(const std::filesystem::path& header, const std::vector<double>& sizes,
               double bytes) {
  for (std::size_t i = 0; i < sizes.size(); ++i) {
    const double size = sizes[i];
    if (size >= 1.0 && size <= std::numeric_limits<int>::max() && size == std::floor(size)) {
      bytes *= size;
      continue;
    }
    throw VolumeError(header.string(),
                      fmt::format("size {} of the image is {}, not a whole number from 1 to {}",
                                  i + 1, size, std::numeric_limits<int>::max()),
                      kCorrectHeader);
  }
  if (bytes > kMostBytes) {
    throw VolumeError(
        header.string(),
        fmt::format("the values need {:.0g} bytes, more than the limit of 1e15", bytes),
        kCorrectHeader);
  }
  return bytes;
}

double sizeOfData(const std::filesystem::path& header, const std::filesystem::path& data,
                  bool follow) {
  // Outside the header's folder, the author of a header could name any file of the user.
  std::error_code unread;  // a missing file is rejected below
  const std::filesystem::path folder =
      std::filesystem::weakly_canonical(std::filesystem::absolute(header).parent_path(), unread);
  const std::filesystem::path named =
      std::filesystem::weakly_canonical(std::filesystem::absolute(data), unread)
          .lexically_relative(folder);
  if (!follow && (named.empty() || *named.begin() == "..")) {
    throw VolumeError(
        header.string(),
        fmt::format("the header names a data file in another folder, {}", data.string()),
        "move the data file beside the header, or add --follow");
  }
  std::error_code error;
  const auto size = std::filesystem::file_size(data, error);
  if (error || !std::filesystem::is_regular_file(data, error)) {
    throw VolumeError(header.string(),
                      fmt::format("the data file {} cannot be read", nameOf(data, header)),
                      "move the data file to the place that the header states");
  }
  return static_cast<double>(size);
}

void checkHeld(const std::filesystem::path& header, const std::filesystem::path& data, double held,
               double least) {
  if (held >= least) return;
  throw VolumeError(header.string(),
                    fmt::format("{} is truncated: it has {:.0f} of {:.0f} bytes",
                                calledBy(header, data), std::max(held, 0.0), std::ceil(least)),
                    "copy or export the file again");
}

}  // namespace palpate::importer
