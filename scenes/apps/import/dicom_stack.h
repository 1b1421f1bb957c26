/// Private to the importer: selects the images of DICOM files that make a volume, orders them and
/// computes their positions. Rejects images that do not fit, and names them.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "palpate/scenes/apps/import/dicom_header.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Images that have one series identity.
struct Series {
  std::string uid;
  std::vector<const File*> files;
  std::size_t images = 0;
};

/// Returns a line such as: 2: "T1 axial" MR 24 images.
[[nodiscard]] std::string nameOf(std::size_t number, const Series& series);

/// Groups files by series. Sorted by series number, then identity. The files have to outlive the
/// result.
[[nodiscard]] std::vector<Series> seriesOf(const std::vector<File>& files);

/// Returns the requested series, by number, UID or description. Throws VolumeError, which
/// lists all series, unless exactly one fits.
[[nodiscard]] const Series& chosen(const std::vector<Series>& all, const Request& request);

/// The images of a series as one volume, or as one volume for each time step.
struct Stack {
  std::vector<Slices> steps;  ///< In the order of their positions.
  std::vector<double> times;  ///< [s], or step numbers; empty for one step.
  Affine map;
  std::vector<std::string> notes;
};

/// Stacks the images of a series. Throws VolumeError, of `what`, if images differ in size,
/// orientation or kind; if images are missing, unevenly spaced or duplicated; or if no tag
/// distinguishes their times.
[[nodiscard]] Stack stackOf(const Series& series, const std::string& what);

}  // namespace palpate::importer
