/// Finds the side from which a viewer first looks at a scene.
#pragma once

#include "palpate/scenes/guess/metadata.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate::cli {

/// Returns the horizontal unit vector from the scene's centre to the viewer, in W. If a volume has
/// the space of a patient (RAS), the vector points to the patient's front (anterior) at the first
/// such volume's place. Otherwise, and if the patient faces up or down, the vector is -y.
[[nodiscard]] inline Vec3 frontOf(const BuiltScene& built) {
  for (const auto& [name, volume] : built.volumes) {
    const auto placement = built.placements.find(name);
    if (!volume || placement == built.placements.end() || !metadataOf(*volume).ras) continue;
    Vec3 front = placement->second.rotation * Vec3::UnitY();
    front.z() = 0.0;
    constexpr double kLeast = 0.3;  // a shorter vector points mainly up or down
    if (front.norm() >= kLeast) return front.normalized();
    break;
  }
  return -Vec3::UnitY();
}

}  // namespace palpate::cli
