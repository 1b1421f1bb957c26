#include "palpate/samplers/grid/segment_texts.h"

#include <array>
#include <charconv>
#include <cmath>
#include <string_view>

#include "palpate/samplers/grid/label_mask.h"

namespace palpate {
namespace {

/// Returns the `N` numbers of a text, separated by spaces or tabs; no value if the text is anything
/// else or a number is not finite.
template <std::size_t N>
std::optional<std::array<double, N>> numbersOf(const std::string& text) {
  std::array<double, N> numbers{};
  const char* at = text.data();
  const char* const end = at + text.size();
  const auto skip_spaces = [&] {
    while (at != end && (*at == ' ' || *at == '\t')) ++at;
  };
  for (double& number : numbers) {
    skip_spaces();
    const auto [rest, error] = std::from_chars(at, end, number);
    if (error != std::errc() || !std::isfinite(number)) return std::nullopt;
    at = rest;
  }
  skip_spaces();
  return at == end ? std::optional(numbers) : std::nullopt;
}

std::string withoutControls(std::string name) {
  for (char& c : name) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = ' ';
  }
  return name;
}

/// Returns where a field of a segment is stored; null for other fields.
std::string* fieldOf(SegmentTexts& segment, std::string_view field) {
  if (field == "Name") return &segment.name;
  if (field == "LabelValue") return &segment.value;
  if (field == "Color") return &segment.colour;
  if (field == "Layer") return &segment.layer;
  return nullptr;
}

}  // namespace

std::map<std::size_t, SegmentTexts> segmentTexts(const std::map<std::string, std::string>& pairs) {
  constexpr std::string_view kBegin = "Segment";
  std::map<std::size_t, SegmentTexts> segments;
  for (const auto& [key, text] : pairs) {
    if (!key.starts_with(kBegin)) continue;
    const char* const begin = key.data() + kBegin.size();
    const char* const end = key.data() + key.size();
    std::size_t number = 0;
    const auto [rest, error] = std::from_chars(begin, end, number);
    if (error != std::errc() || rest == end || *rest != '_') continue;
    // Skips numbers with leading zeros, such as 05.
    if (std::to_string(number) != std::string_view(begin, rest)) continue;
    SegmentTexts& segment = segments[number];
    if (std::string* field = fieldOf(segment, std::string_view(rest + 1, end))) *field = text;
  }
  return segments;
}

std::optional<double> numberOf(const std::string& text) {
  const auto number = numbersOf<1>(text);
  return number ? std::optional((*number)[0]) : std::nullopt;
}

std::optional<Label> labelOf(const SegmentTexts& segment) {
  const auto value = numberOf(segment.value);
  if (!value || std::abs(*value) > kMostLabel || std::floor(*value) != *value) return std::nullopt;
  Label label{*value, withoutControls(segment.name), std::nullopt};
  if (const auto colour = numbersOf<3>(segment.colour)) {
    label.colour = Vec3(colour->data()).cwiseMax(0.0).cwiseMin(1.0);
  }
  return label;
}

}  // namespace palpate
