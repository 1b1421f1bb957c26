/// Private to the importer: reads an NRRD header. This code finds the data files; teem parses all
/// other fields.
#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace palpate::importer {

inline constexpr const char* kNrrdDamaged =
    "the file may be truncated or damaged: copy or export it again";
inline constexpr const char* kCorrectNrrdHeader = "correct the header";

struct NrrdPart {
  std::filesystem::path file;
  long offset = 0;  ///< Offset of the data after a header in the same file [bytes]; otherwise 0.
  /// Byte skip of this part; if set, replaces that of the header.
  std::optional<long> skip;
};

struct NrrdHeader {
  std::vector<std::string> lines;
  std::map<std::string, std::string> pairs;  ///< Key/value pairs ("key:=value").
  std::vector<NrrdPart> parts;
  unsigned line_skip = 0;
  long byte_skip = 0;
};

/// Reads the header of `file`. Throws VolumeError if it is damaged or names no data file. Does not
/// check that data files exist.
[[nodiscard]] NrrdHeader readNrrdHeader(const std::filesystem::path& file);

/// Returns the index values of an axis, such as the times of a sequence by 3D Slicer ("axis 3 index
/// values:=0 0.1 0.5"). Returns no value unless the header has `count` finite numbers there.
[[nodiscard]] std::optional<std::vector<double>> indexValuesOf(const NrrdHeader& header, int axis,
                                                               std::size_t count);

[[nodiscard]] std::string lowered(std::string text);

}  // namespace palpate::importer
