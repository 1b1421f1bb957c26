/// A hand in a scene, and a path for it.
#pragma once

#include <cmath>
#include <memory>
#include <utility>

#include "palpate/engine/tick/step.h"

namespace palpate::test {

/// A hand in a scene, at 1 kHz, with a force limit of 1000 N.
struct Hand {
  std::unique_ptr<const Scene> scene;
  Reader reader;
  ProxyState state{ForceLimits{1000.0, 1e9}};

  explicit Hand(std::unique_ptr<const Scene> felt) : scene(std::move(felt)) {}
  StepReport step(const Vec3& hand) { return hapticStep(*scene, reader, {hand}, state, 1e-3); }
};

/// Returns the hand's position at a time [s] on a wandering path of `size` [m] to each side.
inline Vec3 wander(double time, double size) {
  return size * Vec3(std::sin(3.1 * time) * std::cos(0.7 * time), std::sin(2.3 * time + 1.0),
                     std::cos(1.7 * time) * std::sin(0.9 * time + 0.4));
}

}  // namespace palpate::test
