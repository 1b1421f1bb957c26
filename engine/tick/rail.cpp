#include "palpate/engine/tick/rail.h"

#include <cmath>

namespace palpate {
namespace {

/// Error of a trace's step, as a share of the scene's tolerance. At a tolerance of 0.01 voxel, the
/// measured sum of errors is at most 0.0101 voxel over 1,280 voxels (docs/motion_accuracy.md).
constexpr double kTraceStep = 2.25e-3;

/// A trace ends if the pull along the stream is at most this share of the scene's tolerance.
constexpr double kNear = 0.1;
/// Longest path along a curve in one trial step [voxels].
constexpr double kLongest = 16.0;

/// A trace and its tangent line, in W.
struct Laid {
  Trace trace;        ///< The trace in the resting frame of its volume.
  Vec3 place;         ///< The end of the trace [m].
  Vec3 ahead;         ///< Unit direction at the end.
  double gone = 0.0;  ///< Arc length [m], >= 0.
};

/// Traces the curve that has `line` as its tangent. The vectors and the length of `order` are in W.
Laid traceLine(Tick& tick, const Curve& along, const Felt& felt, const Body* body,
               const Primitive& line, TraceOrder order) noexcept {
  order.along = line.direction;
  order.tolerance = kTraceStep * tick.scene.step.tolerance_voxels;
  order.near = kNear * tick.scene.step.tolerance_voxels;
  order.stride = along.on->stride;
  order.bend = along.on->bend;
  double stretch = 1.0;  // length in the resting frame / length in W, along the line
  Vec3 start = line.position;
  if (body != nullptr) {
    const Pose& pose = body->pose;
    const Vec3 along_rest = pose.back * line.direction;
    stretch = along_rest.norm() / line.direction.norm();  // exactly 1 if the volume stands still
    order.along = along_rest / stretch;
    order.hand = pose.back * order.hand;
    order.metric = pose.linear.transpose() * pose.linear;
    order.length *= stretch;
    start = pose.toRest(line.position);
  }
  Laid laid;
  laid.trace = felt.bound.trace(along.field, start, order);
  along.on->stride = laid.trace.stride;
  along.on->bend = laid.trace.bend;
  tick.report.traced += laid.trace.samples;
  laid.place = laid.trace.position;
  laid.ahead = laid.trace.direction;
  if (body != nullptr) {
    laid.place = body->pose(laid.trace.position);
    const Vec3 turned = body->pose.vector(laid.trace.direction);
    laid.ahead = laid.trace.direction.norm() / turned.norm() * turned;
  }
  laid.gone = std::abs(laid.trace.length) / stretch;
  return laid;
}

/// Traces the curve of primitive `index`, the line of mode i. Returns true if the proxy moves along
/// the curve.
bool layAlong(Tick& tick, const Curve& along, ModeMemory& of, const Felt& felt, std::size_t i,
              std::size_t index, const Vec3& balance, Rail& rail, Trial& trial) noexcept {
  const Primitive line = tick.balance.primitives.items()[index];
  const Vec3 aside = balance - line.position;
  // [voxels] from the line: if the balance is farther away, the line yields
  constexpr double kOn = 1e-3;
  constexpr double kStays = 1e-5;  // [voxels] along the line: a proxy with a shorter step rests
  along.on->holds =
      (aside - line.direction.dot(aside) * line.direction).norm() <= kOn * along.voxel;
  const double straight = line.direction.dot(trial.end - line.position);
  if (std::abs(straight) < kStays * along.voxel) return false;
  // If the trial step ends before its target, the curve gets the same length. A complete step leads
  // to the place nearest to the hand. If the scene has only this stream, the trace itself reads the
  // stream, so that the reading is valid for longer.
  const bool alone = tick.felt().size() == 1 && felt.graph().modes.size() == 1;
  const double reach =
      alone ? kLongest * along.voxel : std::min(trial.reach, kLongest * along.voxel);
  const bool uncut = trial.complete || (alone && trial.cut);
  TraceOrder order;
  order.to_hand = true;
  order.length = uncut ? std::max(reach, std::abs(straight)) : std::abs(straight);
  // The force that pulls at the line is that of the hand and of all other primitives. The place of
  // the hand is displaced accordingly.
  order.hand = aside - tick.balance.forces[index] / tick.balance.stiffness - rail.waiting;
  const Body* body = tick.around.bodies.of(felt.graph().mode_motions[i]);
  const Laid laid = traceLine(tick, along, felt, body, line, order);
  const Trace& trace = laid.trace;
  // If the stream or its data end, the rest of the step continues straight, but not beyond the
  // hand.
  const bool ends =
      !trace.arrived && !trace.capped && laid.gone < order.length - 1e-9 * along.voxel;
  Vec3 place = laid.place;
  if (ends) {
    const Vec3 on = std::copysign(1.0, straight) * line.direction;
    const double left = on.dot(order.hand - (place - line.position));
    place += std::clamp(left, 0.0, std::max(0.0, std::abs(straight) - laid.gone)) * on;
  }
  const double pull = laid.ahead.dot(order.hand - (place - line.position));
  // A pull within the tolerance waits, unless the line is too weak to bear it.
  const double most = std::min(tick.scene.step.tolerance_voxels * along.voxel,
                               line.strength / tick.balance.stiffness);
  const bool near = std::abs(pull) <= most;
  rail.of = &of;
  rail.motion = felt.graph().mode_motions[i];
  rail.along_rest = trace.direction;
  rail.line = {PrimitiveKind::kLine, place, laid.ahead, line.strength};
  rail.waiting = near ? Vec3(-pull * laid.ahead) : Vec3(Vec3::Zero());
  trial.end += place - (line.position + straight * line.direction);
  if (uncut && !ends) trial.cut = !trace.arrived;
  trial.complete = false;  // properties must be read at the end
  if (trace.hairpin) worsen(tick.report, StepStatus::kHairpin);
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
                  if (rail.of != nullptr && rail.of != &memory) return false;
                  rail.any = true;
                  return layAlong(tick, along, memory, felt, i, index, balance, rail, trial);
                });
}

}  // namespace palpate
