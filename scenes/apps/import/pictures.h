/// Private to the importer: reads grey pictures from PNG and TIFF files, one picture at a time.
#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "palpate/scenes/apps/import/slice_spacing.h"
#include "palpate/scenes/apps/import/values.h"

namespace palpate::importer {

struct PictureFormat {
  int width = 0;   ///< [pixels]
  int height = 0;  ///< [pixels]
  Type type = Type::kUint8;
  bool is_inverted = false;  ///< True if 0 is white in the file, and the numbers are unsigned.

  [[nodiscard]] bool operator==(const PictureFormat&) const = default;
};

/// An open file with grey pictures of any formats.
class Pictures {
 public:
  Pictures() = default;
  Pictures(const Pictures&) = delete;
  Pictures& operator=(const Pictures&) = delete;
  virtual ~Pictures() = default;

  /// Formats of the file's pictures, in its order. The file is large enough for all pixels that
  /// they state, at the highest ratio of its compression.
  [[nodiscard]] virtual const std::vector<PictureFormat>& formats() const = 0;
  /// Reads a picture from the top row to the bottom row, each row from left to right. `to` has room
  /// for all values of formats()[index]. A larger value is brighter, except in pictures of signed
  /// numbers or floats for which 0 is white. Throws VolumeError. The picture of a PNG can be read
  /// once.
  virtual void read(std::size_t index, void* to) = 0;
  /// Facts that the first picture's tags state.
  [[nodiscard]] virtual StatedStack stated() const { return {}; }
  /// Changes to values and omitted pictures, one line each.
  [[nodiscard]] virtual std::vector<std::string> notes() const { return {}; }
};

/// Opens a TIFF or BigTIFF of one or more pages. Throws VolumeError if the file is damaged, or if a
/// page has colours, or a compression or a number type that cannot be read.
[[nodiscard]] std::unique_ptr<Pictures> openTiff(const std::filesystem::path& file);

/// Opens a PNG. Values of 1, 2 and 4 bits keep their numbers. Throws VolumeError if the file is
/// damaged or has colours.
[[nodiscard]] std::unique_ptr<Pictures> openPng(const std::filesystem::path& file);

/// Throws VolumeError for a picture with colours. `which` is the picture, such as "page 2".
[[noreturn]] void refuseColours(const std::filesystem::path& file, const std::string& which);

}  // namespace palpate::importer
