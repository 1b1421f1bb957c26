/// A header of a host program. palpate has a header with the same name.
#pragma once

#include <palpate/scenes/palpate.h>

namespace host {

/// Builds a scene of a ball of 40 mm, felt with 3 N.
inline palpate::BuiltScene buildScene() {
  palpate::SceneSpec spec;
  spec.volumes["ball"].field = palpate::makeSphere(palpate::Vec3::Zero(), 0.04);
  palpate::ModeSpec skin;
  skin.kind = palpate::ModeKind::kIsosurface;
  skin.of = "ball";
  skin.solid = palpate::Solid::kBelow;
  skin.strength = 3.0;
  spec.graph.modes.push_back(skin);
  return palpate::buildScene(spec);
}

}  // namespace host
