/// Private to the importer: finds the slices of a volume in a folder of pictures, by their names.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace palpate::importer {

enum class PictureKind : std::uint8_t { kNone, kPng, kTiff, kJpeg };

/// Returns the kind of a picture by the first bytes of its file.
[[nodiscard]] PictureKind pictureKind(const std::string& bytes);

struct FolderFile {
  std::string name;
  PictureKind kind = PictureKind::kNone;
};

struct SliceNames {
  std::vector<std::string> slices;  ///< File names in the order of their numbers, at least 2.
  std::uint64_t step = 1;           ///< Difference of the numbers of two neighbouring slices.
  std::vector<std::string> notes;   ///< Ignored files.
};

/// Selects the files of a volume's slices, and orders them by number (2 before 10). A series is a
/// set of PNG files, or of TIFF files, whose names are equal except for numbers. Numbers have at
/// most 18 digits. The slices are the largest series of the folder; a note counts all other files.
/// Throws VolumeError, which names `folder`, if
/// - no series has two files, or two series are the largest;
/// - the names differ in more than one number, or a number occurs twice;
/// - numbers are missing: the steps from number to number differ.
[[nodiscard]] SliceNames orderSlices(const std::string& folder, std::vector<FolderFile> files);

}  // namespace palpate::importer
