#include "palpate/scenes/library/label_modes.h"

#include <string>
#include <utility>

#include <fmt/format.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/library/spec_lookup.h"

namespace palpate {
namespace {

JsonType<LabelKey> oneLabelType() {
  const JsonType<int> whole =
      jsonWhole(-static_cast<int>(kMostLabel), static_cast<int>(kMostLabel));
  const JsonType<std::string> name = jsonName();
  return {{{"oneOf", JsonSchema::array({whole.schema, name.schema})}},
          [whole = whole.read, name = name.read](const JsonNode& node) -> LabelKey {
            if (node.json().is_string()) return name(node);
            if (node.json().is_number()) return static_cast<double>(whole(node));
            node.fail(node.json().dump() + " is not a label",
                      "write its number, its name in quotes, or a list of both");
          }};
}

std::string volumeNameOf(const MaskSpec& mask) {
  const std::string name = mask.of + ":" + textOf(mask.labels);
  return mask.smooth == kMaskSigma ? name : fmt::format("{} (smooth {:g})", name, mask.smooth);
}

/// Path and name of the first mode that reads a mask. If no mode reads it: those of the mask.
struct MaskReader {
  std::string path;
  std::string name;
};

MaskReader firstReaderOf(const SceneSpec& spec, const std::string& mask) {
  for (std::size_t i = 0; i < spec.graph.modes.size(); ++i) {
    const ModeSpec& mode = spec.graph.modes[i];
    if (mode.of != mask) continue;
    const std::string path = fmt::format("/modes/{}", i);
    return {path, mode.name.empty() ? path : "\"" + mode.name + "\""};
  }
  return {"/volumes/" + mask, "\"" + mask + "\""};
}

/// Throws SceneError if the volume cannot have masks.
void checkLabels(const SceneSpec& spec, const BuiltScene& built, const MaskSpec& mask,
                 const MaskReader& reader) {
  const VolumeSpec& labels = spec.volumes.at(mask.of);
  const auto refuse = [&](bool wrong, const char* why, const char* remedy) {
    if (!wrong) return;
    throw SceneError(pathIn(spec, reader.path + "/of"), "\"" + mask.of + "\" " + why, remedy);
  };
  refuse(isGiven(labels.field), "is a field of the program, which has no labels",
         "give a volume of voxels");
  refuse(isSequence(labels), "is a sequence, in which labels cannot be selected",
         "write a grid for each label, 1 inside of the label and 0 elsewhere, in each frame");
  refuse(built.windows.count(mask.of) != 0, "is in bricks, in which labels cannot be selected",
         "use the .vdb from which the bricks were made");
  refuse(labels.smooth.sigma != 0.0, "is smoothed at load, which blends its labels",
         "remove \"smooth\" from the volume, and put it beside \"label\" in the mode");
  refuse(built.volumes.count(mask.of) == 0, "is the displacement of another volume",
         "name a volume of labels");
}

}  // namespace

JsonType<std::vector<LabelKey>> labelType() {
  const JsonType<LabelKey> one = oneLabelType();
  const JsonType<std::vector<LabelKey>> several =
      jsonList(one, "it is an empty list", "write [7, \"liver\", ...]");
  JsonSchema any = one.schema;
  any["oneOf"].push_back(several.schema);
  return {any, [one = one.read, several = several.read](const JsonNode& node) {
            if (node.json().is_array()) return several(node);
            return std::vector<LabelKey>{one(node)};
          }};
}

bool isMask(const VolumeSpec& volume) {
  return volume.mask.has_value() && volume.volume == nullptr;
}

void addMask(SceneSpec& spec, std::size_t number, MaskSpec mask) {
  const std::string path = fmt::format("/modes/{}", number);
  const auto labels = spec.volumes.find(mask.of);
  if (labels == spec.volumes.end()) {
    std::vector<std::string> names;
    for (const auto& [name, volume] : spec.volumes) names.push_back(name);
    throw unknownVolume(pathIn(spec, path + "/of"), mask.of, names);
  }
  // Labels such as 7 and "7" give the same text; their masks get different names.
  std::string name = volumeNameOf(mask);
  auto known = spec.volumes.find(name);
  for (int n = 2; known != spec.volumes.end() && known->second.mask && known->second.mask != mask;
       ++n) {
    name = fmt::format("{} ({})", volumeNameOf(mask), n);
    known = spec.volumes.find(name);
  }
  ModeSpec& mode = spec.graph.modes.at(number);
  mode.of = name;
  mode.value = 0.5;
  if (known != spec.volumes.end() && known->second.mask) return;
  if (known != spec.volumes.end() || spec.graph.fields.count(name) != 0) {
    throw SceneError(pathIn(spec, path + "/label"),
                     "palpate names the mask of this label \"" + name +
                         "\", but a volume or field of the scene has this name",
                     "rename that volume or field");
  }
  VolumeSpec volume;
  volume.place.kind = PlaceSpec::Kind::kLike;
  volume.place.like = mask.of;
  volume.mask = std::move(mask);
  spec.volumes[name] = std::move(volume);
}

void computeMasks(const SceneSpec& spec, BuiltScene& built, SceneCache& cache) {
  for (const auto& [name, volume] : spec.volumes) {
    if (!isMask(volume)) continue;
    const MaskSpec& mask = *volume.mask;
    const MaskReader reader = firstReaderOf(spec, name);
    checkLabels(spec, built, mask, reader);
    try {
      built.volumes[name] = cache.mask(built.volumes.at(mask.of), mask.labels, mask.smooth);
    } catch (const VolumeError& e) {
      throw SceneError::within(pathIn(spec, reader.path + "/label"), e);
    }
    built.computed[name] = {fmt::format("label {} of {}, smoothed with sigma = {:g} voxels",
                                        textOf(mask.labels), mask.of, mask.smooth),
                            mask.of, fmt::format("mode {} needs its surface", reader.name)};
  }
}

}  // namespace palpate
