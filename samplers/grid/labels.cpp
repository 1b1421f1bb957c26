#include "palpate/samplers/grid/labels.h"

#include <array>
#include <charconv>
#include <cstddef>
#include <map>
#include <string>
#include <utility>

#include "palpate/samplers/grid/segment_texts.h"

namespace palpate {
namespace {

constexpr const char* kSegment = "Segment";
constexpr const char* kSegmentName = "Name";
constexpr const char* kSegmentValue = "LabelValue";
constexpr const char* kSegmentColour = "Color";

std::string segmentKey(std::size_t number, const char* field) {
  return kSegment + std::to_string(number) + "_" + field;
}

}  // namespace

std::vector<Label> labelsIn(const openvdb::MetaMap& metadata) {
  constexpr std::size_t kMost = 10'000;
  std::map<std::string, std::string> pairs;
  for (auto entry = metadata.beginMeta(); entry != metadata.endMeta(); ++entry) {
    if (!entry->first.starts_with(kSegment)) continue;
    if (const auto text = metadata.getMetadata<openvdb::StringMetadata>(entry->first)) {
      pairs[entry->first] = text->value();
    }
  }
  std::vector<Label> labels;
  for (const auto& [number, segment] : segmentTexts(pairs)) {
    if (labels.size() == kMost) break;
    if (auto label = labelOf(segment)) labels.push_back(std::move(*label));
  }
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
