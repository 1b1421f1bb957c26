#include "palpate/engine/rail.h"

#include <cmath>

namespace palpate {
namespace {

/// Error of a trace's step, as a share of the scene's tolerance. Measured: for 0.01 voxel at most
/// 0.0101 voxel adds up over 1,280 voxels of any stream tried (docs/motion_accuracy.md).
constexpr double kTraceStep = 2.25e-3;

/// Lays primitive `index`, the line of mode i, along its curve. True if it holds a moving proxy.
bool layAlong(Tick& tick, const Curve& along, ModeMemory& of, const Felt& felt, std::size_t i,
              std::size_t index, const Vec3& balance, Rail& rail, Trial& trial) noexcept {
  const Primitive& line = tick.balance.primitives.items()[index];
  const Vec3& force = tick.balance.forces[index];
  const Vec3 go = trial.end - line.position;
  const Vec3 aside = balance - line.position;
  constexpr double kOn = 1e-3;     // [voxels] from the line: beyond, it yields
  constexpr double kStays = 1e-5;  // [voxels] along the line: below, the proxy rests
  along.on->holds =
      (aside - line.direction.dot(aside) * line.direction).norm() <= kOn * along.voxel;
  if (!along.on->holds) return false;
  if (std::abs(line.direction.dot(go)) < kStays * along.voxel) return false;
  const Body* body = tick.around.bodies.of(felt.graph().mode_motions[i]);
  const double k = tick.balance.stiffness;
  TraceOrder order;
  order.length = line.direction.dot(go);
  order.along = line.direction;
  // The hand relative to the line's place [m], or what other primitives leave of its pull.
  order.hand = line.direction.dot(aside) * line.direction - force / k;
  const Vec3 hand = order.hand;
  double stretch = 1.0;  // of the line, from W to where the volume rests
  if (body != nullptr) {
    const Vec3 along_rest = body->pose.back * line.direction;
    stretch = along_rest.norm() / line.direction.norm();
    order.along = along_rest / stretch;
    order.hand = body->pose.back * order.hand;
    order.length *= stretch;
  }
  order.tolerance = kTraceStep * tick.scene.step.tolerance_voxels;
  order.stride = along.on->stride;
  const Trace trace = felt.bound.trace(
      along.field, body == nullptr ? line.position : body->pose.toRest(line.position), order);
  along.on->stride = trace.stride;
  tick.report.traced += trace.samples;
  const Vec3 curve = body == nullptr ? trace.position : body->pose(trace.position);
  Vec3 ahead = trace.direction;
  if (body != nullptr) {
    const Vec3 turned = body->pose.vector(trace.direction);
    ahead = trace.direction.norm() / turned.norm() * turned;
  }
  // Where the stream or its data end, the rest of the length goes straight on.
  const double rest =
      trace.capped || trace.shortened ? 0.0 : (order.length - trace.length) / stretch;
  const Vec3 on = line.direction.dot(go) * line.direction;
  const Vec3 shift = curve + rest * line.direction - (line.position + on);
  // A curve that leads farther from its tangent than the line's strength reaches cannot be held,
  // nor can a place on it that is farther than that from the hand.
  const Vec3 left = hand - (curve - line.position);
  if (trace.shortened && !(left.norm() <= line.strength / k)) return true;
  const Vec3 waiting = shift + ahead.dot(force) / k * ahead;
  if (!(waiting.norm() <= line.strength / k)) return true;
  rail.of = &of;
  rail.motion = felt.graph().mode_motions[i];
  rail.along_rest = trace.direction;
  rail.line = {PrimitiveKind::kLine, curve + rest * line.direction, ahead, line.strength};
  rail.waiting = waiting;
  trial.end += shift;
  trial.complete = false;  // the end is where properties are to be read
  if (trace.hairpin) worsen(tick.report, StepStatus::kHairpin);
  if (trace.capped) worsen(tick.report, StepStatus::kSubstepLimit);
  return true;
}

}  // namespace

void keepRail(const Tick& tick, const Vec3& at, Rail& rail) noexcept {
  if (rail.of == nullptr || rail.motion < 0) return;
  const auto motion = static_cast<std::size_t>(rail.motion);
  if (tick.scene.graph.motions[motion]->warp() == nullptr) return;
  const Body& body = *tick.around.bodies.of(rail.motion);
  rail.line.position += body.pose(body.seen + body.swept) - at;
  rail.line.direction = body.pose.vector(rail.along_rest).normalized();
}

void layRail(Tick& tick, const Vec3& balance, Rail& rail, Trial& trial) noexcept {
  rail.laid = true;
  std::size_t first = 0;
  (void)anyMode(tick.felt(),
                [&](const Mode& mode, ModeMemory& memory, const Felt& felt, std::size_t i) {
                  const std::size_t index = first;
                  first += static_cast<std::size_t>(memory.emitted);
                  const Curve along = curveOf(mode, memory);
                  if (along.field < 0 || memory.emitted == 0) return false;
                  return layAlong(tick, along, memory, felt, i, index, balance, rail, trial);
                });
}

}  // namespace palpate
