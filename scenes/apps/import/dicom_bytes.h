/// Private to the importer: detects DICOM files, and inflates deflated data sets.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>

namespace palpate::importer {

/// Returns true if a file that begins with these bytes is a DICOM file. Without the preamble of 128
/// bytes, its first two elements must be little-endian, in order, and in groups 0002 to 0010.
[[nodiscard]] bool beginsAsDicom(std::string_view bytes);

/// Gives vtk-dicom, which cannot inflate, a plain file: inflates a deflated data set in memory.
class PlainDicom {
 public:
  /// Throws VolumeError, which names `file`, if the data set is damaged or exceeds 4 GiB.
  explicit PlainDicom(const std::filesystem::path& file);
  PlainDicom(const PlainDicom&) = delete;
  PlainDicom& operator=(const PlainDicom&) = delete;
  ~PlainDicom();

  /// Returns the path of the file, or of the inflated copy, which this object owns.
  [[nodiscard]] const std::string& path() const { return path_; }

 private:
  std::string path_;
  int memory_ = -1;  ///< File descriptor of the copy; -1: no copy.
};

/// Decodes a frame that has one bit per pixel and RLE compression (DICOM PS3.5, annex G) to values
/// 0 or 1. `item` has a header of 64 bytes and the segment. Returns false if `item` is damaged or
/// has a different number of pixels.
[[nodiscard]] bool decodeBits(std::string_view item, std::size_t pixels, unsigned char* out);

}  // namespace palpate::importer
