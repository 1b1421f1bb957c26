#include "palpate/scenes/apps/import/nrrd_segments.h"

#include <charconv>
#include <cmath>
#include <set>
#include <sstream>

#include <fmt/format.h>

#include "palpate/samplers/grid/label_mask.h"

namespace palpate::importer {
namespace {

constexpr const char* kBegin = "Segment";

/// Returns the numbers of the segments, from keys such as Segment12_ID.
std::set<std::size_t> segmentNumbers(const std::map<std::string, std::string>& pairs) {
  const std::string begin = kBegin;
  std::set<std::size_t> numbers;
  for (const auto& [key, value] : pairs) {
    if (!key.starts_with(begin)) continue;
    std::size_t number = 0;
    const auto [rest, error] =
        std::from_chars(key.data() + begin.size(), key.data() + key.size(), number);
    if (error == std::errc() && *rest == '_') numbers.insert(number);
  }
  return numbers;
}

/// Returns a number that is the whole text.
std::optional<double> numberIn(const std::string& text) {
  std::istringstream in(text);
  double number = 0.0;
  if (!(in >> number)) return std::nullopt;
  in >> std::ws;
  return in.eof() ? std::optional(number) : std::nullopt;
}

std::optional<Vec3> colourIn(const std::string& text) {
  std::istringstream in(text);
  Vec3 colour;
  in >> colour.x() >> colour.y() >> colour.z();
  if (in.fail() || !colour.allFinite()) return std::nullopt;
  return colour.cwiseMax(0.0).cwiseMin(1.0);
}

}  // namespace

std::optional<std::vector<std::vector<Label>>> segmentsIn(
    const std::map<std::string, std::string>& pairs, std::size_t layers,
    std::vector<std::string>& notes) {
  const std::set<std::size_t> numbers = segmentNumbers(pairs);
  if (numbers.empty()) return std::nullopt;
  std::vector<std::vector<Label>> found(layers);
  for (const std::size_t number : numbers) {
    const auto text = [&](const char* field) {
      const auto pair = pairs.find(fmt::format("{}{}_{}", kBegin, number, field));
      return pair == pairs.end() ? std::string() : pair->second;
    };
    const std::string layer_text = text("Layer");
    const std::string value_text = text("LabelValue");
    const auto layer = layer_text.empty()
                           ? std::optional(layers > 1 ? static_cast<double>(number) : 0.0)
                           : numberIn(layer_text);
    const auto value = value_text.empty() ? std::optional(1.0) : numberIn(value_text);
    const bool in_file = layer && *layer >= 0.0 && *layer < static_cast<double>(layers) &&
                         std::floor(*layer) == *layer;
    const bool is_label = value && std::abs(*value) <= kMostLabel && std::floor(*value) == *value;
    if (!in_file || !is_label) {
      notes.push_back(fmt::format(
          "segment {} \"{}\" keeps no name: {}", number, text("Name"),
          in_file ? fmt::format("its label value \"{}\" is not a whole number up to {:.0f}",
                                value_text, kMostLabel)
                  : fmt::format("its layer \"{}\" is not one of the {} in the file", layer_text,
                                layers)));
      continue;
    }
    found[static_cast<std::size_t>(*layer)].push_back(
        {*value, text("Name"), colourIn(text("Color"))});
  }
  return found;
}

}  // namespace palpate::importer
