#include "palpate/scenes/library/spec_lookup.h"

#include "palpate/scenes/library/brick_places.h"

namespace palpate {

std::string pathIn(const SceneSpec& spec, const std::string& path) {
  return spec.source.empty() ? path : spec.source + ": " + path;
}

SceneError unknownVolume(const std::string& path, const std::string& name,
                         const std::vector<std::string>& names) {
  const std::string near = nearestName(name, names);
  return {path, "there is no volume \"" + name + "\"",
          near.empty() ? "name a volume of this scene" : "did you mean \"" + near + "\"?"};
}

bool isInBricks(const VolumeSpec& volume) {
  return volume.volume == nullptr && !volume.file.empty() && isBrickPlace(volume.file);
}

bool isSequence(const VolumeSpec& volume) {
  return volume.frames.has_value() && volume.volume == nullptr && !isGiven(volume.field);
}

Sampling samplingOf(const SceneSpec& spec, const std::string& name) {
  Sampling sampling = spec.volumes.at(name).sampling;
  sampling.slope_reach = spec.slope_reach;
  return sampling;
}

}  // namespace palpate
