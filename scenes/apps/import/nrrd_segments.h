/// Private to the importer: the segments of 3D Slicer's .seg.nrrd files.
#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "palpate/samplers/grid/volume.h"

namespace palpate::importer {

/// Returns the labels of each layer of a segmentation; no value if the header has no segments.
///
/// Segment n has the pairs SegmentN_Name, SegmentN_LabelValue (default 1), SegmentN_Color and
/// SegmentN_Layer. Without a pair SegmentN_Layer, segment n is in layer n if there are several
/// layers. Adds a note about each segment that is left out: its layer is not in the file, or its
/// label value is not a whole number that a float can hold.
/// @param pairs   Key/value pairs of the header.
/// @param layers  Number of layers, at least 1.
[[nodiscard]] std::optional<std::vector<std::vector<Label>>> segmentsIn(
    const std::map<std::string, std::string>& pairs, std::size_t layers,
    std::vector<std::string>& notes);

}  // namespace palpate::importer
