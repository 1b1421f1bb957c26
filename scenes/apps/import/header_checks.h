/// Private to the importer: checks that an image's data files can hold what its header states,
/// before any memory is allocated for it.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace palpate::importer {

/// Returns the name of a data file for error messages about `header`: "the file" if the data are in
/// the header file itself, else the name.
[[nodiscard]] std::string calledBy(const std::filesystem::path& header,
                                   const std::filesystem::path& data);

/// Returns the size of an array with these counts along its axes [bytes]. Throws VolumeError, which
/// names `header`, if a count is not a positive whole number or the size exceeds 1e15 bytes.
///
/// @param bytes  Size of one value.
[[nodiscard]] double bytesOf(const std::filesystem::path& header, const std::vector<double>& sizes,
                             double bytes);

/// Returns the size of a data file [bytes]. Throws VolumeError, which names `header`, if the file
/// cannot be read. Unless `follow` is true, also throws if the file, or the target of a link, does
/// not lie in the header's folder or its subfolders.
[[nodiscard]] double sizeOfData(const std::filesystem::path& header,
                                const std::filesystem::path& data, bool follow);

/// Throws VolumeError, which names `header`, if a data file has less than `least` bytes. The data
/// file may be the header file itself.
void checkHeld(const std::filesystem::path& header, const std::filesystem::path& data, double held,
               double least);

/// Returns the smallest possible size of these bytes after compression by deflate, whose ratio is
/// at most 1032:1 [bytes].
[[nodiscard]] constexpr double leastDeflated(double bytes) noexcept {
  return bytes / 1040.0;
}
/// Returns the smallest possible size of values as text [bytes]: a digit and a space for each.
[[nodiscard]] constexpr double leastText(double values) noexcept {
  return 2.0 * values - 1.0;
}

}  // namespace palpate::importer
