/// Private to the importer: checks that an image's data files can hold what its header states,
/// before any memory is allocated for it.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace palpate::importer {

/// Returns the name of a data file for errors of `header`: "the file" if the data are in the
/// header's file, else the name.
[[nodiscard]] std::string calledBy(const std::filesystem::path& header,
                                   const std::filesystem::path& data);

/// Returns the bytes of values with these counts along each axis. Throws VolumeError, of `header`,
/// if a size is not a count or the product exceeds 1e15.
///
/// @param bytes  Size of one value.
[[nodiscard]] double bytesOf(const std::filesystem::path& header, const std::vector<double>& sizes,
                             double bytes);

/// Returns the size of a data file [bytes]. Throws VolumeError, of `header`, if the file
/// cannot be read. Unless `follow` is set, also throws if the file, or the target of a link, lies
/// outside the header's folder and its subfolders.
[[nodiscard]] double sizeOfData(const std::filesystem::path& header,
                                const std::filesystem::path& data, bool follow);

/// Throws VolumeError, of `header`, if a data file, perhaps the header's own, holds less than
/// `least` bytes.
void checkHeld(const std::filesystem::path& header, const std::filesystem::path& data, double held,
               double least);

/// Returns the least size to which deflate packs these bytes: its ratio is at most 1032 to 1.
[[nodiscard]] constexpr double leastDeflated(double bytes) noexcept {
  return bytes / 1040.0;
}
/// Returns the least number of characters of values as text: a digit and a space each.
[[nodiscard]] constexpr double leastText(double values) noexcept {
  return 2.0 * values - 1.0;
}

}  // namespace palpate::importer
