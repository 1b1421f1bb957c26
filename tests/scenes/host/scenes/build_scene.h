/// A host program's header, with the same name as one of palpate's.
#pragma once

#include <palpate/scenes/palpate.h>

namespace host {

/// Builds a scene of a ball of radius 40 mm that holds a hand with up to 3 N.
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
