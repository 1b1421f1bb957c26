/// Private to the importer: detects DICOM files, and inflates deflated data sets.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>

#include "palpate/samplers/descriptor.h"

namespace palpate::importer {

/// Returns true if a file that begins with these bytes is a DICOM file. A file without the preamble
/// of 128 bytes must begin with one big-endian element of group 0008, or with two little-endian
/// elements in ascending order. Of these, the first is in group 0002 or 0008, and the second in a
/// group up to 0010.
[[nodiscard]] bool beginsAsDicom(std::string_view bytes);

/// Inflates a deflated data set in memory, because vtk-dicom reads only data sets that are not
/// deflated.
class PlainDicom {
 public:
  /// Throws VolumeError, which names `file`, if the data set is truncated or damaged, exceeds 4 GiB
  /// or does not fit into memory. Also throws if the file is big-endian without a transfer syntax.
  explicit PlainDicom(const std::filesystem::path& file);

  /// Returns the path of the file, or of the inflated copy, which this object owns.
  [[nodiscard]] const std::string& path() const { return path_; }

 private:
  std::string path_;
  Descriptor memory_;  ///< The copy; -1: no copy.
};

/// Decodes a frame that has one bit per pixel and RLE compression (DICOM PS3.5, annex G) to values
/// 0 or 1. `item` has a header of 64 bytes and the segment. Returns false if `item` is damaged or
/// has a different number of pixels.
[[nodiscard]] bool decodeBits(std::string_view item, std::size_t pixels, unsigned char* out);

}  // namespace palpate::importer
