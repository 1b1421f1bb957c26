/// What holds in every tick, whatever the scene (docs/tick.md, "What holds"): asked of each tick of
/// the motion tests.
#pragma once

#include <algorithm>
#include <stdexcept>
#include <string>

#include "engine/step.h"

namespace palpate::bench {

/// Whether provenStep() proves: a benchmark that times ticks does not.
inline bool& proving() {
  static bool on = true;
  return on;
}

/// hapticStep(); throws std::logic_error where the tick breaks the theorem.
inline StepReport provenStep(const Scene& scene, Reader& reader, const HandState& hand,
                             ProxyState& state, double dt) {
  const Vec3 before = state.proxy();
  const bool placed = state.time() > 0.0;
  const StepReport r = hapticStep(scene, reader, hand, state, dt);
  if (!proving()) return r;
  const double k = r.stiffness;
  const Vec3 offset = r.proxy - hand.position;
  const auto must = [&](bool holds, const char* what, double by) {
    if (holds) return;
    throw std::logic_error("tick at " + std::to_string(state.time()) + " s, " + wordFor(r.status) +
                           ": " + what + " by " + std::to_string(by));
  };
  must(r.status != StepStatus::kFault, "fault", 0.0);
  must(r.substeps <= kMostSubsteps, "more readings than stated", r.substeps);

  // Energy: what the proxy's move adds to the spring is counted.
  if (placed) {
    const double rise =
        0.5 * k * (offset.squaredNorm() - (before - hand.position).squaredNorm()) - r.injected;
    must(rise <= 1e-12 + 1e-9 * k * offset.squaredNorm(), "uncounted energy [nJ]", 1e9 * rise);
  }
  if (r.status > StepStatus::kHairpin) return r;

  // Strength: of what has converged nothing bears more than it can.
  double strengths = 0.0;
  for (const Primitive& primitive : state.primitives().items()) strengths += primitive.strength;
  double voxel = 0.0;
  for (const FieldFrame& frame : scene.graph.scalar_frames) voxel = std::max(voxel, frame.voxel);
  const double tolerance = scene.step.tolerance_voxels * voxel;
  const double over =
      k * (offset.norm() - r.waiting.norm() - tolerance - r.error_bound) - (1.0 + 1e-9) * strengths;
  must(over <= 1e-9, "force above all strengths [N]", over);

  // Surfaces: none that could hold is behind the proxy.
  for (std::size_t i = 0; i < scene.graph.modes.size(); ++i) {
    const auto* of = std::get_if<IsosurfaceMemory>(&state.memory(i).of);
    if (of == nullptr || of->side != Side::kOutside || !of->contact.placed) continue;
    if (of->contact.load == Load::kYielding) continue;
    const double behind = of->contact.normal.dot(of->contact.anchor - r.proxy);
    must(behind <= tolerance + r.error_bound, "behind a surface that holds [voxels]",
         behind / voxel);
  }
  return r;
}

}  // namespace palpate::bench
