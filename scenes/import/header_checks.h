/// Private to the importer: what the header of an image promises against what its files hold,
/// before any memory is taken for it.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace palpate::importer {

/// What an error of `header` calls a data file: "it" if it is the header's own, else its name.
[[nodiscard]] std::string calledBy(const std::filesystem::path& header,
                                   const std::filesystem::path& data);

/// The bytes of so many values along each axis. Throws VolumeError, of `header`, where a size is no
/// count or their product is absurd.
///
/// @param bytes  That one value takes.
[[nodiscard]] double bytesOf(const std::filesystem::path& header, const std::vector<double>& sizes,
                             double bytes);

/// The size of a data file [bytes]. Throws VolumeError, of `header`, where there is none, and where
/// it lies in another folder than the header's (or one within), also by a link, unless `follow`.
[[nodiscard]] double sizeOfData(const std::filesystem::path& header,
                                const std::filesystem::path& data, bool follow);

/// Throws VolumeError, of `header`, where less than so many bytes are held in a data file, perhaps
/// the header's own.
void checkHeld(const std::filesystem::path& header, const std::filesystem::path& data, double held,
               double least);

/// The least that deflate makes of so many bytes: it packs 1032 to 1 at most.
[[nodiscard]] constexpr double leastDeflated(double bytes) noexcept {
  return bytes / 1040.0;
}
/// The least characters of so many values as text: a digit and a space each.
[[nodiscard]] constexpr double leastText(double values) noexcept {
  return 2.0 * values - 1.0;
}

}  // namespace palpate::importer
