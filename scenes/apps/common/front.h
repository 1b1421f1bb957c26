/// Finds the directions of a patient, and the side from which a viewer first looks at a scene.
#pragma once

#include <optional>

#include "palpate/scenes/guess/metadata.h"
#include "palpate/scenes/library/build_scene.h"

namespace palpate::cli {

/// Returns the rotation to W of the first volume, by name, in a patient's space (RAS); no value if
/// there is none.
[[nodiscard]] inline std::optional<Mat3> patientOf(const BuiltScene& built) {
  for (const auto& [name, volume] : built.volumes) {
    const auto placement = built.placements.find(name);
    if (!volume || placement == built.placements.end() || !metadataOf(*volume).ras) continue;
    return placement->second.rotation;
  }
  return std::nullopt;
}

/// Returns the horizontal unit vector from the scene's centre to the viewer, in W. It points to the
/// patient's front (anterior). Without a patient, or if the patient faces mainly up or down, the
/// vector is -y.
[[nodiscard]] inline Vec3 frontOf(const BuiltScene& built) {
  constexpr double kLeast = 0.3;  // a shorter vector points mainly up or down
  const std::optional<Mat3> patient = patientOf(built);
  Vec3 front = patient ? Vec3(*patient * Vec3::UnitY()) : Vec3(-Vec3::UnitY());
  front.z() = 0.0;
  return front.norm() >= kLeast ? Vec3(front.normalized()) : Vec3(-Vec3::UnitY());
}

}  // namespace palpate::cli
