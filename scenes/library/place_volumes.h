/// Places the volumes and guides of a scene in W.
#pragma once

#include <cstddef>
#include <map>
#include <set>
#include <string>

#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Largest distance of a volume or guide from the origin of W [m].
inline constexpr double kFarthestPlace = 1e6;

/// Computes the placements of all volumes. A volume with "like" has the placement of the named
/// volume.
class Placer {
 public:
  /// @param volumes  Grid of each volume, by name.
  ///
  /// The placer refers to both arguments, which must outlive it.
  Placer(const SceneSpec& spec, const std::map<std::string, const GridInfo*>& volumes)
      : spec_(spec), volumes_(volumes) {}

  /// Returns the placement of an instance, for the volume `leader` that has the instances and for
  /// the volumes placed like it. Throws SceneError.
  Placement placementOf(const std::string& leader, std::size_t instance);
  /// Returns the placement of a volume; if it has instances, that of the first one. Throws
  /// SceneError.
  Placement placementOf(const std::string& name);

 private:
  Placement compute(const std::string& name, const PlaceSpec& place, const std::string& path);
  Placement computeAny(const std::string& name, const PlaceSpec& place, const std::string& path);

  const SceneSpec& spec_;
  const std::map<std::string, const GridInfo*>& volumes_;
  std::map<std::string, Placement> done_;
  /// Volumes whose placement was requested. A second request before the first is complete means
  /// that "like" forms a circle.
  std::set<std::string> open_;
};

/// Converts guides from the units and the place of a volume to W. The guides then move with that
/// volume.
void placeGuides(const SceneSpec& spec, const BuiltScene& built, GraphSpec& graph);

}  // namespace palpate
