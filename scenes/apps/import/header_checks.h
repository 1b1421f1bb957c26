/// Private to the importer: checks that data files are as large as an image's header states.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace palpate::importer {

/// Returns the name of a data file for errors, or "the file" if it is the header file.
[[nodiscard]] std::string calledBy(const std::filesystem::path& header,
                                   const std::filesystem::path& data);

/// Returns the size of an array [bytes] with the counts `sizes` along its axes and `bytes` bytes
/// per value. Throws VolumeError, which names `header`, if a count is not a whole number from 1 to
/// 2^31 - 1, or the size exceeds 1e15 bytes.
[[nodiscard]] double bytesOf(const std::filesystem::path& header, const std::vector<double>& sizes,
                             double bytes);

/// Returns the first bytes of a file, at most 4096, as they are stored; "" if it is unreadable.
[[nodiscard]] std::string firstBytesOf(const std::filesystem::path& file);

/// Returns the size of a data file [bytes]. Throws VolumeError, which names `header`, if the data
/// file is missing or is not a regular file. Unless `follow` is true, the file (after all links)
/// must also be in the header's folder or below it.
[[nodiscard]] double sizeOfData(const std::filesystem::path& header,
                                const std::filesystem::path& data, bool follow);

/// Throws VolumeError, which names `header`, if `held` (a file's size) < `least` [bytes].
void checkHeld(const std::filesystem::path& header, const std::filesystem::path& data, double held,
               double least);

/// Returns a lower limit of the size after deflate [bytes]. Deflate compresses at most 1032:1.
[[nodiscard]] constexpr double leastDeflated(double bytes) noexcept {
  return bytes / 1040.0;
}
/// Returns the smallest size of values as text [bytes]: a digit and a space for each.
[[nodiscard]] constexpr double leastText(double values) noexcept {
  return 2.0 * values - 1.0;
}

}  // namespace palpate::importer
