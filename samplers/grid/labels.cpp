#include "palpate/samplers/grid/labels.h"

#include <array>
#include <charconv>
#include <cmath>
#include <cstddef>
#include <map>
#include <optional>
#include <string>

#include "palpate/samplers/grid/label_mask.h"

namespace palpate {
namespace {

constexpr const char* kSegment = "Segment";
constexpr const char* kSegmentName = "Name";
constexpr const char* kSegmentValue = "LabelValue";
constexpr const char* kSegmentColour = "Color";

std::string segmentKey(std::size_t number, const char* field) {
  return kSegment + std::to_string(number) + "_" + field;
}

/// Returns `count` numbers that spaces separate; no value if the text has others.
std::optional<std::array<double, 3>> numbersOfText(const std::string& text, std::size_t count) {
  std::array<double, 3> numbers{};
  const char* at = text.data();
  const char* end = at + text.size();
  for (std::size_t i = 0; i < count; ++i) {
    while (at != end && *at == ' ') ++at;
    const auto [rest, error] = std::from_chars(at, end, numbers.at(i));
    if (error != std::errc() || !std::isfinite(numbers.at(i))) return std::nullopt;
    at = rest;
  }
  while (at != end && *at == ' ') ++at;
  return at == end ? std::optional(numbers) : std::nullopt;
}

std::string withoutControls(std::string name) {
  for (char& c : name) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = ' ';
  }
  return name;
}

std::string metadataText(const openvdb::MetaMap& metadata, const std::string& key) {
  const auto meta = metadata.getMetadata<openvdb::StringMetadata>(key);
  return meta ? meta->value() : std::string();
}

/// Returns the number of a segment whose metadata has this key; no value for other keys.
std::optional<std::size_t> segmentNumber(const std::string& key) {
  const std::string begin = kSegment;
  const std::string end = std::string("_") + kSegmentValue;
  if (!key.starts_with(begin) || !key.ends_with(end)) return std::nullopt;
  std::size_t number = 0;
  const char* last = key.data() + key.size() - end.size();
  const auto [rest, error] = std::from_chars(key.data() + begin.size(), last, number);
  if (error != std::errc() || rest != last || segmentKey(number, kSegmentValue) != key)
    return std::nullopt;
  return number;
}

}  // namespace

std::vector<Label> labelsIn(const openvdb::MetaMap& metadata) {
  constexpr std::size_t kMost = 10'000;
  std::map<std::size_t, Label> found;
  for (auto entry = metadata.beginMeta(); entry != metadata.endMeta(); ++entry) {
    const std::optional<std::size_t> number = segmentNumber(entry->first);
    if (!number || found.size() == kMost) continue;
    const auto value = numbersOfText(metadataText(metadata, entry->first), 1);
    if (!value || std::abs((*value)[0]) > kMostLabel || std::floor((*value)[0]) != (*value)[0]) {
      continue;
    }
    Label label{(*value)[0],
                withoutControls(metadataText(metadata, segmentKey(*number, kSegmentName))),
                std::nullopt};
    if (const auto colour =
            numbersOfText(metadataText(metadata, segmentKey(*number, kSegmentColour)), 3)) {
      const Vec3 rgb((*colour)[0], (*colour)[1], (*colour)[2]);
      label.colour = rgb.cwiseMax(0.0).cwiseMin(1.0);
    }
    found[*number] = std::move(label);
  }
  std::vector<Label> labels;
  labels.reserve(found.size());
  for (auto& [number, label] : found) labels.push_back(std::move(label));
  return labels;
}

void insertLabels(openvdb::MetaMap& metadata, const std::vector<Label>& labels) {
  const auto insert = [&](std::size_t number, const char* field, const std::string& text) {
    metadata.insertMeta(segmentKey(number, field), openvdb::StringMetadata(text));
  };
  const auto shown = [](double number) {
    std::array<char, 32> text{};
    return std::string(text.data(),
                       std::to_chars(text.data(), text.data() + text.size(), number).ptr);
  };
  for (std::size_t i = 0; i < labels.size(); ++i) {
    insert(i, kSegmentValue, shown(labels[i].value));
    if (!labels[i].name.empty()) insert(i, kSegmentName, labels[i].name);
    if (!labels[i].colour) continue;
    const Vec3& c = *labels[i].colour;
    insert(i, kSegmentColour, shown(c.x()) + " " + shown(c.y()) + " " + shown(c.z()));
  }
}

}  // namespace palpate
