#include "palpate/scenes/apps/import/header_checks.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <fstream>
#include <ios>
#include <limits>
#include <system_error>

#include <fmt/format.h>

#include "palpate/engine/error.h"

namespace palpate::importer {
namespace {

constexpr double kMostBytes = 1e15;
constexpr const char* kCorrectSizes = "correct the sizes, or check the program that wrote them";

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
                      kCorrectSizes);
  }
  if (bytes > kMostBytes) {
    throw VolumeError(
        header.string(),
        fmt::format("the values need {:.3g} bytes, more than the limit of 1e15", bytes),
        kCorrectSizes);
  }
  return bytes;
}

double sizeOfData(const std::filesystem::path& header, const std::filesystem::path& data,
                  bool follow) {
  // Without this check, the author of a header could make the importer read any file of the user.
  std::error_code unread;  // a missing file is rejected below
  const std::filesystem::path folder =
      std::filesystem::weakly_canonical(std::filesystem::absolute(header).parent_path(), unread);
  const std::filesystem::path real =
      std::filesystem::weakly_canonical(std::filesystem::absolute(data), unread);
  const std::filesystem::path named = real.lexically_relative(folder);
  if (!follow && (named.empty() || *named.begin() == "..")) {
    throw VolumeError(header.string(),
                      fmt::format("the header names a data file in another folder, {}",
                                  (real.empty() ? data : real).string()),
                      "move the data file beside the header, or add --follow");
  }
  std::error_code error;
  const bool is_file = std::filesystem::is_regular_file(data, error);
  const auto size = is_file ? std::filesystem::file_size(data, error) : 0;
  if (!is_file || error) {
    throw VolumeError(header.string(),
                      fmt::format("the data file {} cannot be read ({})", nameOf(data, header),
                                  error ? error.message() : "it is not a regular file"),
                      "put a readable file at this path, or correct the file name in the header");
  }
  return static_cast<double>(size);
}

void checkHeld(const std::filesystem::path& header, const std::filesystem::path& data, double held,
               double least) {
  if (held >= least) return;
  throw VolumeError(header.string(),
                    fmt::format("{} has {:.0f} of at least {:.0f} bytes: it is truncated, or the "
                                "header is wrong",
                                calledBy(header, data), std::max(held, 0.0), std::ceil(least)),
                    "copy or export the file again, or correct the header");
}

std::string firstBytesOf(const std::filesystem::path& file) {
  std::string bytes(4096, '\0');
  std::ifstream in(file, std::ios::binary);
  in.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  bytes.resize(static_cast<std::size_t>(in.gcount()));
  return bytes;
}

}  // namespace palpate::importer
