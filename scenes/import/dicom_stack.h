/// Private to the importer: which images of DICOM files make a volume, in which order, and where
/// they are. What does not fit is refused by name.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "palpate/scenes/import/dicom_header.h"
#include "palpate/scenes/import/reader.h"

namespace palpate::importer {

/// Images that say that they belong together.
struct Series {
  std::string uid;
  std::vector<const File*> files;
  std::size_t images = 0;
};

/// "2: "T1 axial" MR 24 images"
[[nodiscard]] std::string nameOf(std::size_t number, const Series& series);

/// By series number, then identity. The files have to outlive them.
[[nodiscard]] std::vector<Series> seriesOf(const std::vector<File>& files);

/// The one that is asked for: by number, identity or description. Throws VolumeError that lists
/// them.
[[nodiscard]] const Series& chosen(const std::vector<Series>& all, const Request& request);

/// The images of a series as a volume, or as one for each step.
struct Stack {
  std::vector<Slices> steps;  ///< In the order of their places.
  std::vector<double> times;  ///< [s], or numbers; empty for one step.
  Affine map;
  std::vector<std::string> notes;
};

/// Stacks the images of a series. Throws VolumeError, of `what`, where they differ in size,
/// orientation or kind, where some are missing, uneven or twice there, and where nothing tells one
/// time from another.
[[nodiscard]] Stack stackOf(const Series& series, const std::string& what);

}  // namespace palpate::importer
