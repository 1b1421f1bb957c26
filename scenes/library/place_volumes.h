#pragma once

#include <cstddef>
#include <map>
#include <set>
#include <string>

#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Largest distance of a volume from the origin of W, and largest coordinate of a guide or of a
/// keyframe's translation [m].
inline constexpr double kFarthestPlace = 1e6;

/// Computes the placements of all volumes. A volume with "like" gets the placement of the named
/// volume.
class Placer {
 public:
  /// Both arguments must outlive the placer. `volumes` has the properties of each volume's grid, by
  /// name.
  Placer(const SceneSpec& spec, const std::map<std::string, const GridInfo*>& volumes)
      : spec_(spec), volumes_(volumes) {}

  /// Returns the placement of an instance of the volume `leader`. Volumes that are placed like
  /// `leader` have the same placement. Throws SceneError.
  Placement placementOf(const std::string& leader, std::size_t instance);
  /// Returns the placement of a volume, or of its first instance. Throws SceneError.
  Placement placementOf(const std::string& name);

 private:
  Placement compute(const std::string& name, const PlaceSpec& place, const std::string& path);
  Placement computeAny(const std::string& name, const PlaceSpec& place, const std::string& path);

  const SceneSpec& spec_;
  const std::map<std::string, const GridInfo*>& volumes_;
  std::map<std::string, Placement> done_;
  /// Volumes whose placement was requested. A second request before the placement is in `done_`
  /// means a circle of "like".
  std::set<std::string> open_;
};

/// Converts guides from the units and place of a volume to W. The guides then move with the volume.
/// Throws SceneError for an unknown volume.
void placeGuides(const SceneSpec& spec, const BuiltScene& built, GraphSpec& graph);

}  // namespace palpate
