/// Checks statements of the section "What holds in every tick" of docs/tick.md in each tick of the
/// motion tests.
#pragma once

#include <algorithm>
#include <stdexcept>
#include <string>

#include "palpate/engine/tick/step.h"

namespace palpate::bench {

/// Switch of provenStep()'s checks. Benchmarks that time ticks set it to false.
inline bool& proving() {
  static bool on = true;
  return on;
}

/// Runs hapticStep(). If proving() is true, throws std::logic_error if the tick violates a
/// statement that is checked here.
inline StepReport provenStep(const Scene& scene, Reader& reader, const HandState& hand,
                             ProxyState& state, double dt) {
  const Vec3 before = state.proxy();
  const bool placed = state.time() > 0.0;
  if (!proving()) return hapticStep(scene, reader, hand, state, dt);
  StepTrace trace;
  StepReport r = hapticStep(scene, reader, hand, state, dt, &trace);
  const auto foreseen = [](const StepTrace::Step& step) { return step.foreseen; };
  const auto slices = std::count_if(trace.steps().begin(), trace.steps().end(), foreseen);
  const double k = r.stiffness;
  const Vec3 offset = r.proxy - hand.position;
  const auto must = [&](bool holds, const char* what, double by) {
    if (holds) return;
    throw std::logic_error("tick at " + std::to_string(state.time()) + " s, " + wordFor(r.status) +
                           ": " + what + " by " + std::to_string(by));
  };
  must(r.status != StepStatus::kFault, "fault", 0.0);
  must(r.substeps <= kMostSubsteps, "more readings than stated", r.substeps);

  // Energy: a tick with a single move reports all energy that the move adds to the spring.
  if (placed && slices == 1) {
    const double rise =
        0.5 * k * (offset.squaredNorm() - (before - hand.position).squaredNorm()) - r.injected;
    must(rise <= 1e-12 + 1e-9 * k * offset.squaredNorm(), "uncounted energy [nJ]", 1e9 * rise);
  }
  if (r.status > StepStatus::kHairpin) return r;

  // Strength: in a converged tick, the force is at most the sum of the strengths.
  double strengths = 0.0;
  for (const Primitive& primitive : state.primitives().items()) strengths += primitive.strength;
  double voxel = 0.0;
  for (const FieldFrame& frame : scene.graph.scalar_frames) voxel = std::max(voxel, frame.voxel);
  const auto varying = state.primitives().varying();
  if (std::any_of(varying.begin(), varying.end(), [](const Varying& v) { return !v.surface; })) {
    for (const FieldFrame& frame : scene.graph.vector_frames) voxel = std::max(voxel, frame.voxel);
  }
  // Strengths that depend on the position are those at the last reading, which was at most the
  // tolerance away from the proxy.
  const double once = scene.step.tolerance_voxels * voxel;
  for (const Varying& one : varying) strengths += one.slope.norm() * once;
  // The proxy is within the tolerance of the tick's result. This result is within the tolerance of
  // the largest offset that the strengths can hold.
  const double tolerance = 2.0 * once;
  const double over =
      k * (offset.norm() - r.waiting.norm() - tolerance - r.error_bound) - (1.0 + 1e-9) * strengths;
  must(over <= 1e-9, "force above all strengths [N]", over);

  // Surfaces: by the field's values, the proxy is not behind a surface that was read and holds.
  for (std::size_t i = 0; i < scene.graph.modes.size(); ++i) {
    const auto* mode = std::get_if<IsosurfaceMode>(&scene.graph.modes[i]);
    const auto* of = std::get_if<IsosurfaceMemory>(&state.memory(i).of);
    if (mode == nullptr || of == nullptr || of->side != Side::kOutside) continue;
    const auto plane = static_cast<std::size_t>(of->contact.plane);
    if (!of->contact.seen || of->contact.plane < 0) continue;
    if (loadOf(state.primitives().items()[plane], state.forces()[plane]) != Load::kHeld) continue;
    const SurfaceSource& skin = mode->skin;
    const auto field = static_cast<std::size_t>(skin.field);
    if (scene.graph.scalar_motions[field] >= 0) continue;
    const ScalarField& values = *scene.graph.scalar_fields[field];
    FieldCache cache;
    values.reset(cache);
    const ScalarSample at = values.sample(r.proxy, cache);
    const double slope = values.cellGradient(r.proxy, cache).norm();
    if (!at.inside || !(slope > 0.0)) continue;
    const double behind =
        skin.sign * (mode->level - at.value) * skin.metres_per_unit / (slope * skin.voxel);
    // If the last step crosses a cell's face, the error is up to 1.5 times the tolerance.
    must(behind <= 1.5 * scene.step.tolerance_voxels + r.error_bound / skin.voxel,
         "behind a surface that holds [voxels]", behind);
  }
  return r;
}

}  // namespace palpate::bench
