/// Private to samplers and the importer: the texts that 3D Slicer's .seg.nrrd files keep of
/// segments.
#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>

#include "palpate/samplers/grid/volume.h"

namespace palpate {

/// The texts of one segment. A text that is missing is empty.
struct SegmentTexts {
  std::string name;    ///< SegmentN_Name
  std::string value;   ///< SegmentN_LabelValue
  std::string colour;  ///< SegmentN_Color: "red green blue", 0 to 1
  std::string layer;   ///< SegmentN_Layer
};

/// Returns the segments by their numbers N, which have no leading zeros. Other keys than
/// SegmentN_FIELD are ignored.
[[nodiscard]] std::map<std::size_t, SegmentTexts> segmentTexts(
    const std::map<std::string, std::string>& pairs);

/// Returns the number that is the whole text, except for spaces around it; no value for another
/// text or a number that is not finite.
[[nodiscard]] std::optional<double> numberOf(const std::string& text);

/// Returns the label of a segment; no value if the text of its value is not a whole number of at
/// most kMostLabel in magnitude. Control characters in the name become spaces. A colour that is not
/// three numbers is left out. The numbers of a colour are limited to 0 to 1.
[[nodiscard]] std::optional<Label> labelOf(const SegmentTexts& segment);

}  // namespace palpate
