#include "palpate/scenes/apps/import/nrrd_segments.h"

#include <cmath>

#include <fmt/format.h>

#include "palpate/samplers/grid/label_mask.h"
#include "palpate/samplers/grid/segment_texts.h"

namespace palpate::importer {

std::optional<std::vector<std::vector<Label>>> segmentsIn(
    const std::map<std::string, std::string>& pairs, std::size_t layers,
    std::vector<std::string>& notes) {
  const std::map<std::size_t, SegmentTexts> segments = segmentTexts(pairs);
  if (segments.empty()) return std::nullopt;
  std::vector<std::vector<Label>> found(layers);
  for (auto [number, segment] : segments) {
    if (segment.value.empty()) segment.value = "1";
    const auto layer = segment.layer.empty()
                           ? std::optional(layers > 1 ? static_cast<double>(number) : 0.0)
                           : numberOf(segment.layer);
    const auto label = labelOf(segment);
    const bool in_file = layer && *layer >= 0.0 && *layer < static_cast<double>(layers) &&
                         std::floor(*layer) == *layer;
    if (in_file && label) {
      found[static_cast<std::size_t>(*layer)].push_back(*label);
      continue;
    }
    notes.push_back(fmt::format(
        "segment {} \"{}\" keeps no name: {}", number, segment.name,
        in_file ? fmt::format("its label value \"{}\" is not a whole number up to {:.0f}",
                              segment.value, kMostLabel)
                : fmt::format("its layer \"{}\" is not one of the {} in the file", segment.layer,
                              layers)));
  }
  return found;
}

}  // namespace palpate::importer
