/// Private to the importer: detects DICOM files by their first bytes, and inflates those with a
/// deflated data set.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>

namespace palpate::importer {

/// Returns true if a file with these first bytes is a DICOM file: with the preamble of 128 bytes,
/// or without it, as old scanners and some archives write. Without a preamble, the first two
/// elements must be in groups 0002 to 0010, in order, with little-endian numbers.
[[nodiscard]] bool beginsAsDicom(std::string_view bytes);

/// A DICOM file for readers that cannot inflate (vtk-dicom). If the transfer syntax is Deflated
/// Explicit VR Little Endian, the constructor makes an inflated copy in memory.
class PlainDicom {
 public:
  /// Throws VolumeError, which names `file`, if the data set is damaged or needs more than 4 GiB.
  explicit PlainDicom(const std::filesystem::path& file);
  PlainDicom(const PlainDicom&) = delete;
  PlainDicom& operator=(const PlainDicom&) = delete;
  ~PlainDicom();

  /// Returns the path of the file or of its inflated copy. The copy exists as long as this object.
  [[nodiscard]] const std::string& path() const { return path_; }

 private:
  std::string path_;
  int memory_ = -1;  ///< File descriptor of the copy; -1 without a copy.
};

/// Decodes a frame of an image with one bit per pixel that is compressed with RLE (DICOM PS3.5,
/// annex G).
/// @param item    The frame's item: a header of 64 bytes, then the segment.
/// @param pixels  Number of pixels of a frame.
/// @param out     `pixels` values, 0 or 1.
/// @return        False if the item is damaged or has another number of pixels.
[[nodiscard]] bool decodeBits(std::string_view item, std::size_t pixels, unsigned char* out);

}  // namespace palpate::importer
