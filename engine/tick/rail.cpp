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

/// A trace, and the line at its end in W.
struct Laid {
  Trace trace;        ///< The trace in the resting frame of its volume.
  Vec3 place;         ///< The end of the trace [m].
  Vec3 ahead;         ///< Unit direction at the end.
  double gone = 0.0;  ///< Arc length [m], >= 0.
};

/// Traces the curve with `line` as its tangent. The vectors and the length of `order` are in W.
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

/// The line of a stream in the last balance.
struct Followed {
  Curve along;
  ModeMemory* of = nullptr;
  const Felt* felt = nullptr;
  std::size_t mode = 0;
  std::size_t index = 0;  ///< Index of the line in the balance.

  [[nodiscard]] int motion() const noexcept { return felt->graph().mode_motions[mode]; }
};

template <class Do>
void eachFollowed(const Tick& tick, Do&& look) noexcept {
  std::size_t first = 0;
  eachMode(tick.felt(), [&](const Mode& mode, ModeMemory& memory, const Felt& felt, std::size_t i) {
    const std::size_t index = first;
    first += static_cast<std::size_t>(memory.emitted);
    const Curve along = curveOf(mode, memory);
    if (along.field < 0 || memory.emitted == 0) return;
    look(Followed{along, &memory, &felt, i, index});
  });
}

/// Returns the entry for a stream's line, a new entry if needed; null if `rail` is full.
RailLine* entryFor(const ModeMemory& memory, Rail& rail) noexcept {
  for (std::size_t i = 0; i < rail.count; ++i) {
    if (rail.lines[i].of == &memory) return &rail.lines[i];
  }
  return rail.count < Rail::kMost ? &rail.lines[rail.count++] : nullptr;
}

/// Returns true if another plane or line that holds the proxy crosses the line `index`, and so
/// fixes the proxy along it. The angle between a curve and a wall changes along the curve. Without
/// this check, the wall's force would count as constant and push the proxy off the wall.
///
/// A wall along the stream does not fix the proxy. Its angle to the line is at most the angle by
/// which curve and normal turn over the step. `bend` is the curve's second derivative [1/m],
/// `straight` the step along the line [m].
bool fixedAlong(const Tick& tick, std::size_t index, double bend, double straight) noexcept {
  constexpr double kAside = 0.02;  // least sine of an angle that counts, as in newton.cpp
  const auto primitives = tick.balance.primitives.items();
  const auto varying = tick.balance.primitives.varying();
  const Vec3& along = primitives[index].direction;
  auto varies = varying.begin();
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    while (varies != varying.end() && varies->index < i) ++varies;
    const Primitive& other = primitives[i];
    const bool plane = other.kind == PrimitiveKind::kPlane;
    if (i == index || !(plane || other.kind == PrimitiveKind::kLine)) continue;
    if (loadOf(other, tick.balance.forces[i]) != Load::kHeld) continue;
    const double share = std::abs(other.direction.dot(along));
    const double angle = plane ? share : std::sqrt(std::max(0.0, 1.0 - share * share));
    const bool turns = varies != varying.end() && varies->index == i;
    const double turn = bend + (turns ? (varies->turn * along).norm() : 0.0);
    if (angle > kAside + turn * std::abs(straight)) return true;
  }
  return false;
}

/// Traces the curve of a stream. Returns true if the proxy moves along the curve.
bool layAlong(Tick& tick, const Followed& one, const Vec3& balance, Rail& rail,
              Trial& trial) noexcept {
  const Curve& along = one.along;
  const Primitive line = tick.balance.primitives.items()[one.index];
  const Vec3 aside = balance - line.position;
  constexpr double kStays = 1e-5;  // [voxels] along the line: a proxy with a shorter step rests
  const double straight = line.direction.dot(trial.end - line.position);
  if (std::abs(straight) < kStays * along.voxel) {
    // `waiting` belongs to the line that the proxy followed before.
    if (rail.followed != one.of) rail.waiting.setZero();
    rail.followed = one.of;
    return false;
  }
  // If the trial step ends before its target, or if a wall fixes the target, the trace gets the
  // length of the step. Otherwise it ends at the point nearest to the hand. If the scene has only
  // this stream, the trace itself reads the stream, so the reading is valid for longer.
  const bool alone = tick.felt().size() == 1 && one.felt->graph().modes.size() == 1;
  const double reach =
      alone ? kLongest * along.voxel : std::min(trial.reach, kLongest * along.voxel);
  const bool fixed =
      !alone && fixedAlong(tick, one.index, along.on->bend.norm() / along.voxel, straight);
  const bool uncut = !fixed && (trial.complete || (alone && trial.cut));
  TraceOrder order;
  order.to_hand = !fixed;
  order.length = uncut ? std::max(reach, std::abs(straight)) : std::abs(straight);
  if (fixed) order.length = straight;
  // The forces of the other primitives, divided by k, count as a displacement of the hand.
  order.hand = aside - tick.balance.forces[one.index] / tick.balance.stiffness - rail.waiting;
  const Body* body = tick.around.bodies.of(one.motion());
  const Laid laid = traceLine(tick, along, *one.felt, body, line, order);
  const Trace& trace = laid.trace;
  // If the stream ends, the step continues straight: by the rest of its length if a wall fixes its
  // end, else at most to the point nearest to the hand.
  const bool ends =
      !trace.arrived && !trace.capped && laid.gone < std::abs(order.length) - 1e-9 * along.voxel;
  Vec3 place = laid.place;
  if (ends) {
    const Vec3 on = std::copysign(1.0, straight) * line.direction;
    const double rest = std::max(0.0, std::abs(straight) - laid.gone);
    const double left = on.dot(order.hand - (place - line.position));
    place += (fixed ? rest : std::clamp(left, 0.0, rest)) * on;
  }
  const double pull = laid.ahead.dot(order.hand - (place - line.position));
  // A pull within the tolerance becomes `waiting`, unless the line is too weak to bear it.
  const double most = std::min(tick.scene.step.tolerance_voxels * along.voxel,
                               line.strength / tick.balance.stiffness);
  const bool near = !fixed && std::abs(pull) <= most;
  RailLine* entry = entryFor(*one.of, rail);
  if (entry == nullptr) entry = &rail.lines.back();  // a line that the proxy does not follow
  *entry = {one.of, one.motion(), trace.direction, place, laid.ahead, line.strength};
  rail.followed = one.of;
  rail.waiting = near ? Vec3(-pull * laid.ahead) : Vec3(Vec3::Zero());
  trial.end += place - (line.position + straight * line.direction);
  if (uncut && !ends) trial.cut = !trace.arrived;
  trial.complete = false;  // properties must be read at the end
  if (trace.hairpin) worsen(tick.report, StepStatus::kHairpin);
  return true;
}

/// Traces the curve of a stream that the proxy does not follow, to the curve's point nearest to
/// `end` [m]. If the stream or its data end before, the line is the tangent at that end.
void layBeside(Tick& tick, const Followed& one, const Vec3& end, Rail& rail) noexcept {
  const Primitive line = tick.balance.primitives.items()[one.index];
  RailLine* entry = entryFor(*one.of, rail);
  if (entry == nullptr) return;
  TraceOrder order;
  order.to_hand = true;
  order.length = kLongest * one.along.voxel;
  order.hand = end - line.position;
  const Body* body = tick.around.bodies.of(one.motion());
  const Laid laid = traceLine(tick, one.along, *one.felt, body, line, order);
  *entry = {one.of, one.motion(), laid.trace.direction, laid.place, laid.ahead, line.strength};
}

}  // namespace

void keepRail(const Tick& tick, const Vec3& at, Rail& rail) noexcept {
  for (std::size_t i = 0; i < rail.count; ++i) {
    RailLine& one = rail.lines[i];
    if (one.motion < 0) continue;
    const auto motion = static_cast<std::size_t>(one.motion);
    if (tick.scene.graph.motions[motion]->warp() == nullptr) continue;
    const Body& body = *tick.around.bodies.of(one.motion);
    one.place += body.pose(body.seen + body.swept) - at;
    one.ahead = body.pose.vector(one.along_rest).normalized();
  }
}

void layRail(Tick& tick, const Vec3& balance, Rail& rail, Trial& trial) noexcept {
  rail.laid = true;
  if (!hasCurve(tick.felt())) return;
  Followed best;
  bool best_holds = false;
  double strength = 0.0;
  std::size_t count = 0;
  eachFollowed(tick, [&](const Followed& one) {
    const Primitive& line = tick.balance.primitives.items()[one.index];
    const Vec3 aside = balance - line.position;
    // [voxels] from the line: if the balance is farther away, the line yields
    constexpr double kOn = 1e-3;
    const bool holds =
        (aside - line.direction.dot(aside) * line.direction).norm() <= kOn * one.along.voxel;
    one.along.on->holds = holds;
    const bool better = holds == best_holds ? line.strength > strength : holds;
    if (count++ > 0 && !better) return;
    best = one;
    best_holds = holds;
    strength = line.strength;
  });
  if (count == 0) return;
  rail.any = true;
  if (!layAlong(tick, best, balance, rail, trial) || count == 1) return;
  eachFollowed(tick, [&](const Followed& one) {
    if (one.of != best.of) layBeside(tick, one, trial.end, rail);
  });
}

}  // namespace palpate
