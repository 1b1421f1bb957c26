/// Private to the importer: selects, sorts and places the DICOM images of a volume.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "palpate/scenes/apps/import/dicom_header.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

struct Series {
  std::string uid;
  std::vector<const File*> files;
  std::size_t images = 0;
};

/// Returns a line for the user, such as: 2: "T1 axial" MR 24 images.
[[nodiscard]] std::string nameOf(std::size_t number, const Series& series);

/// Groups the files that are images by series, sorted by number, then by UID. `files` must outlive
/// the result.
[[nodiscard]] std::vector<Series> seriesOf(const std::vector<File>& files);

/// Returns the reason why a series cannot be a volume; "" if it can be a volume, or if one of its
/// files is damaged.
[[nodiscard]] std::string reasonAgainst(const Series& series);

/// Returns the series that the user requests by number, UID or description. Without a request,
/// returns the only series, or the only one of several that can be a volume, and adds a note about
/// each of the others. Throws VolumeError with a list of the series unless exactly one fits.
[[nodiscard]] const Series& chosen(const std::vector<Series>& all, const Request& request,
                                   std::vector<std::string>& notes);

/// Removes screen saves and localisers, unless the series has nothing else. Adds a note.
[[nodiscard]] Series withoutStrays(const Series& series, std::vector<std::string>& notes);

struct Stack {
  std::vector<Slices> steps;  ///< Slices of each step, sorted by position.
  /// Times of the steps [s]; empty if there is one step. If the files state only numbers of steps,
  /// and no TemporalResolution, 1 s is assumed between successive numbers.
  std::vector<double> times;
  Affine map;
  std::vector<double> depths;  ///< Value of Piece::depths; empty if the slices are evenly spaced.
  std::vector<std::string> notes;
};

/// Stacks the images of a series. Throws VolumeError, which names `what`, if they do not form a
/// volume: for example, if images differ in kind, size or orientation, are missing or duplicated,
/// are not on a line, or have equal times.
[[nodiscard]] Stack stackOf(const Series& series, const std::string& what);

}  // namespace palpate::importer
