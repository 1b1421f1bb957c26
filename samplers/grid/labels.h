/// Private to samplers and scenes, for .cpp files only: labels in the metadata of a grid.
#pragma once

#include <vector>

#include "palpate/samplers/grid/openvdb_grids.h"
#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// Returns the labels of a grid. Label n is in the text metadata SegmentN_LabelValue, SegmentN_Name
/// and SegmentN_Color ("red green blue", 0 to 1), the fields of 3D Slicer's .seg.nrrd files. Omits
/// a label whose value is not a whole number of at most kMostLabel in magnitude. Reads at most
/// 10,000 labels. Control characters in a name become spaces.
[[nodiscard]] std::vector<Label> labelsIn(const openvdb::MetaMap& metadata);

/// Adds labels to the metadata of a grid, as labelsIn() reads them.
void insertLabels(openvdb::MetaMap& metadata, const std::vector<Label>& labels);

}  // namespace palpate
