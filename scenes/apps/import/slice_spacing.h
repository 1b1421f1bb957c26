/// Private to the importer: the spacing of slices, as the user or the tags of a TIFF state it.
#pragma once

#include <string>

#include "palpate/scenes/apps/import/reader.h"

namespace palpate::importer {

/// Parses the option --spacing: three positive lengths and an optional unit, as in 10,10,20um.
/// Converts a unit that scenes do not know, such as nm, to um or mm. Throws Error.
[[nodiscard]] Spacing spacingOf(const std::string& text);

/// Tags of a TIFF page.
struct TiffTags {
  std::string description;    ///< ImageDescription; empty: none.
  double x_resolution = 0.0;  ///< Pixels per unit; 0: not stated.
  double y_resolution = 0.0;
  int resolution_unit = 1;  ///< 1: none, 2: inch, 3: cm.
};

/// Facts that the tags of a TIFF state about the whole stack. Counts are 0 if they are not stated.
struct StatedStack {
  /// Edges of a voxel; 0 along an axis: not stated. The unit is empty only if all edges are 0.
  Spacing spacing;
  std::string source;            ///< Origin of the spacing, for messages.
  bool from_resolution = false;  ///< True: the edges may be those of a print, such as 72 per inch.
  double pictures = 0.0;
  double channels = 0.0;
  double times = 0.0;
};

/// Reads OME-XML, ImageJ's description or the resolution. ImageJ does not write a distance of 1
/// between slices. So this distance is assumed if ImageJ's description has several images and a
/// unit, but no distance. Lengths become m, cm, mm or um. Never throws: text that it does not
/// understand states nothing.
[[nodiscard]] StatedStack statedBy(const TiffTags& tags);

}  // namespace palpate::importer
