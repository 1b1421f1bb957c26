// The scene of the programs in docs/embed.md: a ball of radius 4 cm that holds a hand with up to 2
// N, with a coupling that the arm renders stably.
#pragma once

#include <memory>

#include "palpate/scenes/palpate.h"

inline std::shared_ptr<const palpate::Scene> ball(const palpate::DeviceInfo& arm) {
  palpate::SceneSpec spec;
  spec.any_stiffness = true;  // the arm's limit may lower the default
  (void)palpate::fitCoupling(spec, arm);
  spec.volumes["ball"].field = palpate::makeSphere(palpate::Vec3::Zero(), 0.04);
  palpate::ModeSpec skin;
  skin.kind = palpate::ModeKind::kIsosurface;
  skin.of = "ball";
  skin.solid = palpate::Solid::kBelow;
  skin.strength = 2.0;
  spec.graph.modes.push_back(skin);
  return palpate::buildScene(spec).scene;
}
