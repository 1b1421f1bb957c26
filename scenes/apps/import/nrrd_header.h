/// Private to the importer: reads the text of an NRRD header, and separates the fields that locate
/// the data. teem parses the remaining text, while this code decides which files are opened.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace palpate::importer {

inline constexpr const char* kNrrdDamaged =
    "the file may be truncated or damaged: copy or export it again";
inline constexpr const char* kCorrectNrrdHeader = "correct the header";

/// A file that holds a part of the values.
struct NrrdPart {
  std::filesystem::path file;
  long offset = 0;  ///< Position behind a header in the same file [bytes]; else 0.
  /// Byte skip of this part; if set, replaces the byte skip of the header.
  std::optional<long> skip;
};

/// A header without the fields that locate the data.
struct NrrdHeader {
  std::vector<std::string> lines;
  std::vector<NrrdPart> parts;
  unsigned line_skip = 0;
  long byte_skip = 0;
};

/// Reads the header at the beginning of `file`. Throws VolumeError if it is damaged or names no
/// data file. Does not check whether the data files exist.
[[nodiscard]] NrrdHeader readNrrdHeader(const std::filesystem::path& file);

/// Returns the text in lower case (ASCII).
[[nodiscard]] std::string lowered(std::string text);

}  // namespace palpate::importer
