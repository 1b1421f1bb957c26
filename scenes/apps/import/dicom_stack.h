/// Private to the importer: selects the DICOM images that make a volume, sorts them and computes
/// their positions. Images that do not fit are rejected by name.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "palpate/scenes/apps/import/dicom_header.h"
#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// The images of one series, which have the same series UID.
struct Series {
  std::string uid;
  std::vector<const File*> files;
  std::size_t images = 0;
};

/// Returns a line for the user, such as: 2: "T1 axial" MR 24 images.
[[nodiscard]] std::string nameOf(std::size_t number, const Series& series);

/// Groups files by series. The series are sorted by series number, then by UID. `files` must
/// outlive the result.
[[nodiscard]] std::vector<Series> seriesOf(const std::vector<File>& files);

/// Returns the series that the user has requested by number, UID or description. Without a request,
/// returns the only series that can be a volume: localisers, screen saves, single images and images
/// without a position cannot. Adds a note about each such series. Throws VolumeError, with a list
/// of all series, unless exactly one series fits.
[[nodiscard]] const Series& chosen(const std::vector<Series>& all, const Request& request,
                                   std::vector<std::string>& notes);

/// Returns a series without the screen saves and localisers among its slices. Adds a note with the
/// name of a file. If the series has no other images, returns the whole series.
[[nodiscard]] Series withoutStrays(const Series& series, std::vector<std::string>& notes);

/// The images of a series, as one volume for each time step.
struct Stack {
  std::vector<Slices> steps;  ///< The slices of each step, sorted by position.
  /// Times of the steps [s], or their numbers; empty if there is one step.
  std::vector<double> times;
  Affine map;
  std::vector<double> depths;  ///< Value of Piece::depths; empty if the slices are evenly spaced.
  std::vector<std::string> notes;
};

/// Stacks the images of a series. Throws VolumeError, which names `what`, if images differ in size,
/// orientation or kind; if images are missing, duplicated or not on a line; or if no tag
/// distinguishes their times.
[[nodiscard]] Stack stackOf(const Series& series, const std::string& what);

}  // namespace palpate::importer
