/// Places of a scene's volumes and guides in W.
#pragma once

#include <cstddef>
#include <map>
#include <set>
#include <string>

#include "palpate/scenes/library/build_scene.h"

namespace palpate {

/// Largest distance of any place from the origin of W [m].
inline constexpr double kFarthestPlace = 1e6;

/// Resolves the places of all volumes. A volume with "like" takes the place of the named volume.
class Placer {
 public:
  /// Both arguments have to outlive the placer. `volumes` holds the grid of each volume, by name.
  Placer(const SceneSpec& spec, const std::map<std::string, const GridInfo*>& volumes)
      : spec_(spec), volumes_(volumes) {}

  /// Returns an instance's placement, for the volume with the instances and those placed like it.
  /// Throws SceneError.
  Placement placementOf(const std::string& leader, std::size_t instance);
  /// Returns the placement of a volume, or of its first instance. Throws SceneError.
  Placement placementOf(const std::string& name);

 private:
  Placement compute(const std::string& name, const PlaceSpec& place, const std::string& path);
  Placement computeAny(const std::string& name, const PlaceSpec& place, const std::string& path);

  const SceneSpec& spec_;
  const std::map<std::string, const GridInfo*>& volumes_;
  std::map<std::string, Placement> done_;
  std::set<std::string> open_;  ///< Volumes whose placement was requested; finds circles of "like".
};

/// Transforms guides from a volume's units to W; the guides move with the volume.
void placeGuides(const SceneSpec& spec, const BuiltScene& built, GraphSpec& graph);

}  // namespace palpate
