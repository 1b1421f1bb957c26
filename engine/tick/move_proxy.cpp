#include "palpate/engine/tick/move_proxy.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "palpate/engine/tick/decide.h"
#include "palpate/engine/tick/iteration.h"
#include "palpate/engine/tick/sweep.h"
#include "palpate/engine/tick/trial.h"

namespace palpate {
namespace {

/// Largest number of steps of a tick that lead beyond the chosen parts.
constexpr int kMostStrays = 16;
/// Largest number of steps in which a waiting proxy is pulled through surfaces that cannot hold it.
constexpr int kMostStrides = 4;
/// After this number of free ticks, the memories are those of a place without primitives. The
/// memories stay the same while the path is free, and a tick need not read.
constexpr int kSettled = 2;
constexpr double kFree = 1e-9;  ///< [m]: a proxy within this distance of the probe counts as free
/// A reading that advances at most this share of the tolerance stalls. Two successive stalls end
/// the slice.
constexpr double kStalls = 0.1;

/// Returns true if a reading displaced by `way` [m] made no progress on a stream. A stream ends
/// where directions without a sign point into a face from both sides, even if the hand pulls along
/// it.
bool stalls(const Tick& tick, const Iteration& now, const Vec3& way) noexcept {
  const double least = kStalls * tick.scene.step.tolerance_voxels * now.voxel;
  return now.rail.count > 0 && tick.balance.surfaces == 0 && way.norm() <= least;
}

enum class Slice : std::uint8_t {
  kSpoilt,   ///< A number was not finite.
  kWaiting,  ///< The readings were used up; the rest of the path waits.
  kArrived,
};

void meetParts(Tick& tick) noexcept {
  Surroundings& around = tick.around;
  around.near.meet(tick.scene, tick.reader, tick.proxy.position, tick.probe,
                   tick.balance.primitives, tick.report);
  around.count = 1 + around.near.bind(tick.scene, tick.reader, std::span(around.graphs).subspan(1));
}

/// Returns the place of the proxy for the remembered primitives [m]. The volume of the surface that
/// holds the proxy carries this place along. If no surface holds the proxy, the volume of the first
/// mode with primitives does. `Proxy::beyond` turns with that volume.
Vec3 carriedProxy(Tick& tick) noexcept {
  if (tick.around.bodies.empty()) return tick.proxy.position;
  const Body* by = nullptr;
  (void)anyMode(tick.felt(),
                [&](const Mode& mode, ModeMemory& memory, const Felt& felt, std::size_t i) {
                  const Body* body = tick.around.bodies.of(felt.graph().mode_motions[i]);
                  if (body == nullptr || !body->moved) return false;
                  const ContactReference touch = touchOf(mode, memory);
                  const bool holds = touch.skin != nullptr && touch.contact->placed;
                  const bool acts = touch.skin == nullptr && memory.emitted > 0;
                  if (holds || (acts && by == nullptr)) by = body;
                  return holds;
                });
  if (by == nullptr) return tick.proxy.position;
  tick.proxy.beyond = by->carry.vector(tick.proxy.beyond);
  return by->carried;
}

/// Moves the proxy to the end of a trial step, and counts the work that primitives did on it. On a
/// single stream this work is the rise of the spring's energy. The force of the line is
/// perpendicular to the curve, but not to its chord.
void moveTo(Tick& tick, const Iteration& now, const Trial& trial) noexcept {
  Proxy& proxy = tick.proxy;
  const Vec3 before = proxy.offset;
  proxy.position = trial.end;
  proxy.beyond = trial.end - now.last_read;
  proxy.offset = trial.complete ? now.to.target_offset : Vec3(trial.end - tick.probe);
  tick.report.waiting = now.rail.waiting;
  const bool lone = now.rail.count > 0 && tick.balance.primitives.size() == 1;
  const double work = lone ? 0.5 * (proxy.offset.squaredNorm() - before.squaredNorm())
                           : proxy.offset.dot(proxy.offset - before);
  tick.report.injected += std::max(0.0, tick.balance.stiffness * work);
  tick.around.bodies.stand(proxy.position);
}

void tell(const Tick& tick, const Trial& trial) noexcept {
  if (tick.trace->count == 0) return;
  StepTrace::Step& step = tick.trace->all[tick.trace->count - 1];
  step.went = trial.end;
  step.end = trial.complete  ? StepEnd::kFree
             : trial.strays  ? StepEnd::kParts
             : trial.met     ? StepEnd::kSurface
             : trial.trusted ? StepEnd::kTrusted
                             : StepEnd::kVoxel;
}

/// Moves a waiting proxy towards the hand, as far as the reading is valid, if the pull on it
/// exceeds the sum of all strengths. A stream releases the proxy. A single plane that can bear its
/// load stays, and the proxy follows the hand along the plane. Otherwise the proxy is pushed
/// through the surfaces.
void pressThrough(Tick& tick, Iteration& now, Trial& trial) noexcept {
  const BalanceMemory& b = tick.balance;
  const bool on_rail = now.rail.count > 0;
  if ((b.surfaces > 0) == on_rail) return;  // neither surfaces nor a stream, or both
  const double held = reachOfStrengths(tick);
  const double enough = (1.0 + 1e-9) * held;
  const auto pulled = [&] { return (trial.end - tick.probe).norm() > enough; };
  const auto go = [&](const Vec3& offset) {
    now.read_at = trial.end;
    now.to.target_offset = offset;
    now.to.target = tick.probe + offset;
    now.trust.radius = std::numeric_limits<double>::infinity();
    trial = advance(tick, now, false);
    trial.end -= trial.lift;
  };
  if (!pulled()) return;
  if (b.surfaces == 1) {
    const auto varying = b.primitives.varying();
    const auto one = std::find_if(varying.begin(), varying.end(),
                                  [](const Varying& varies) { return varies.surface; });
    const Primitive& plane = b.primitives.items()[one->index];
    const Vec3 offset = trial.end - tick.probe;
    const Vec3 pressed = std::max(offset.dot(plane.direction), 0.0) * plane.direction;
    if (pressed.norm() * tick.balance.stiffness < plane.strength) {
      const Vec3 along = offset - pressed;
      const double left = std::sqrt(held * held - pressed.squaredNorm());
      go(pressed + std::min(1.0, left / along.norm()) * along);
    }
  }
  if (!pulled()) return;
  if (!on_rail) {
    eachSurface(tick.felt(), [](const Mode& mode, ModeMemory& memory, const Felt&, std::size_t) {
      followYielding(mode, memory);
    });
  }
  // A surface that the proxy reaches here is a new surface, and ends the loop.
  bool met = false;
  for (int i = 0; i < kMostStrides && !met && pulled(); ++i) {
    const Vec3 offset = trial.end - tick.probe;
    go(held / offset.norm() * offset);
    met = trial.met;
  }
}

/// Ends the slice. If `arrived`, the proxy moves to answer(). Otherwise no readings are left, and
/// the proxy moves to the target of the shortest step; on a stream, to the end of the curve.
Slice stop(Tick& tick, Iteration& now, Trial trial, bool arrived) noexcept {
  if (arrived) {
    const Vec3 at = answer(tick, now);
    now.to.target_offset = now.to.offset + (at - now.to.proxy);
    now.to.target = trial.end = at;
  }
  const TrustRegion& trust = now.trust;
  const bool best = trust.least < now.to.step.norm();
  if (!arrived && now.rail.count == 0 && (best || anchored(tick.balance))) {
    now.read_at = trust.least_at;
    now.to.target = trust.least_target;
    now.to.target_offset = now.to.target - tick.probe;
    trial = advance(tick, now, false);
  }
  trial.end -= trial.lift;
  if (!arrived) {
    now.rail.waiting.setZero();  // the balance was not found
    pressThrough(tick, now, trial);
  }
  if (tick.trace != nullptr) tell(tick, trial);
  moveTo(tick, now, trial);
  return arrived ? Slice::kArrived : Slice::kWaiting;
}

Slice comeToHand(Tick& tick, const Iteration& now, const Trial& trial) noexcept {
  tick.proxy.lost = tick.proxy.lost || !trial.complete || !trial.swept;
  const Trial there{now.to.target};
  if (tick.trace != nullptr) tell(tick, there);
  moveTo(tick, now, there);
  return Slice::kArrived;
}

/// Returns true if no readings, iterations or choices of parts are left for this slice, or if its
/// stream stalls. `later` readings are reserved for later slices. `stalled` is the number of
/// consecutive readings without progress on a stream.
bool isSpent(const Tick& tick, const Trial& trial, int later, int stalled) noexcept {
  const StepParams& params = tick.scene.step;
  return tick.held + later >= params.max_substeps ||
         tick.report.substeps + later >= kMostSubsteps ||
         tick.report.iterations >= params.max_iterations || stalled > 1 ||
         (trial.strays && tick.strayed > kMostStrays);
}

/// Ends the slice without a reading if the reading of an earlier tick is still valid. This requires
/// that only the hand has moved since then, and that only surfaces without friction hold the proxy.
/// The balance must be within the tolerance of the place of that reading. The scene's finest voxel
/// counts, because a mode without a contact may begin there. Fields that stream or play data are
/// read in every tick. The path from that place is swept. Returns false if properties must be read.
bool stay(Tick& tick, Iteration& now) noexcept {
  const BalanceMemory& b = tick.balance;
  const Graph& graph = tick.scene.graph;
  if (!tick.proxy.arrived || !graph.attentive.empty()) return false;
  const Vec3 read_at = tick.proxy.position - tick.proxy.beyond;
  const double tolerance = tick.scene.step.tolerance_voxels * std::min(now.voxel, graph.finest);
  if (b.surfaces == 0 || b.surfaces != b.primitives.size() ||
      !((now.to.target - read_at).norm() <= tolerance) || now.follows || !now.to.found ||
      !steady(tick, now)) {
    return false;
  }
  const Vec3 from = now.read_at;
  now.last_read = now.read_at = read_at;
  now.read = true;
  Trial trial{now.to.target};
  sweep(tick, now, trial);
  if (!trial.met) {
    (void)stop(tick, now, trial, true);
    return true;
  }
  // The slice now reads properties, which sets `last_read`. The surface that the sweep has reached
  // stays `touched`: it is within the tolerance of the place of that reading.
  now.read = false;
  now.read_at = from;
  return false;
}

/// Moves the proxy to the balance, while volumes and hand do not move. First balances the
/// primitives of the last reading. Then reads properties at the end of the step, places new planes
/// and balances again, until Newton's step is within the tolerance or no readings are left. Leaves
/// `later` readings for later slices.
Slice follow(Tick& tick, int later) noexcept {
  Iteration now;
  now.read_at = tick.proxy.position;
  Vec3 from = carriedProxy(tick);  // position of the proxy for the last reading's primitives
  bool cut = false;
  bool met_free = false;
  int stalled = 0;  // number of consecutive readings without progress
  if (!balance(tick, now, true, from)) return Slice::kSpoilt;
  if (stay(tick, now)) return Slice::kArrived;
  for (;;) {
    Trial trial = advance(tick, now, false);
    TrialState state;
    state.read = now.read;
    state.within = now.read && (trial.near || !cut) && trial.complete && steady(tick, now);
    state.spent = isSpent(tick, trial, later, stalled);
    state.held = tick.balance.primitives.size() > 0;
    Next next = decide(state);
    // A free proxy moves to the hand even if no readings are left. The rest of the path is only
    // swept, and properties are read where the sweep reaches a surface.
    const bool free = next == Next::kRelease;
    if (free) {
      trial = advance(tick, now, true);
      next = decide(SweepState{trial.complete, trial.strays, tick.strayed > kMostStrays, met_free});
      met_free = met_free || (next == Next::kRead && !trial.strays);
    }
    if (next != Next::kRead) {
      const bool arrived = next == Next::kArrive;
      if (!arrived && (later == 0 || free)) worsen(tick.report, StepStatus::kSubstepLimit);
      return free ? comeToHand(tick, now, trial) : stop(tick, now, trial, arrived);
    }
    if (tick.trace != nullptr) tell(tick, trial);
    cut = trial.cut;
    // If the data have changed since the last tick, its reading does not limit the trust.
    const bool compared = now.read || !tick.changed;
    read(tick, now, trial.end);
    const Vec3 way = now.read_at - from;
    from = now.read_at;
    if (cut) {
      moveTo(tick, now, trial);
      now.trust.forgetLeast();
      now.rail.clear();
      if (trial.strays) meetParts(tick);
    }
    if (!balance(tick, now, false, from)) return Slice::kSpoilt;
    trust(tick, now, way, compared);
    const bool lays = now.rail.any && !steady(tick, now);
    if (lays) now.rail.laid = false;
    stalled = lays && stalls(tick, now, way) ? stalled + 1 : 0;
    const bool met = !trial.complete && !trial.cut && !trial.trusted;
    if (met || now.to.offset.norm() > kFree) ++tick.held;
  }
}

/// Returns the number of slices of the hand's motion: more than one only if a stream holds the
/// proxy. Each slice is at most a voxel long, as long as each has two of StepParams::max_substeps
/// readings. In a single slice, a fast hand would be farther from the tangent at the proxy than
/// from the curve.
int handSlices(const Tick& tick, const Vec3& hand_before) noexcept {
  if (!hasCurve(tick.felt())) return 1;
  double most = std::numeric_limits<double>::infinity();
  eachMode(tick.felt(), [&](const Mode& mode, ModeMemory& memory, const Felt&, std::size_t) {
    most = std::min(most, sliceOf(mode, memory));
  });
  const double slices = std::ceil((tick.probe - hand_before).norm() / most);
  const int cap = std::max(1, tick.scene.step.max_substeps / 2);
  return static_cast<int>(std::clamp<double>(slices, 1.0, cap));
}

void moveBodies(Tick& tick, int slice, int slices) noexcept {
  const Graph& graph = tick.scene.graph;
  Surroundings& around = tick.around;
  tick.report.samples += around.bodies.move(graph, slice, slices, tick.proxy.position);
  tick.felt()[0].bound.turn(around.properties, around.bodies.items());
  for (std::size_t i = 0; i < graph.modes.size(); ++i) {
    const Body* body = around.bodies.of(graph.mode_motions[i]);
    if (body != nullptr && body->moved) carry(body->carry, around.memories[i]);
  }
}

/// Fields that the path from the proxy to the hand may meet.
struct OnWay {
  bool any = false;  ///< True if a field may act without a contact.
  /// Fields of Graph::contact_only on the path (bit i: scalar_fields[i]).
  std::uint64_t contact_only = 0;
};

/// Returns the fields with bounds on the straight path from the proxy to the hand. Omits fields
/// that are empty within the distance to the hand. Ends at the first field that may act without a
/// contact.
OnWay fieldsOnWay(const Tick& tick) noexcept {
  const Graph& graph = tick.scene.graph;
  const Vec3& a = tick.proxy.position;
  const Vec3& b = tick.probe;
  const Box way{a.cwiseMin(b), a.cwiseMax(b)};
  OnWay on;
  const auto look = [&](const auto& fields, const std::vector<FieldFrame>& frames,
                        std::uint64_t contact_only) {
    const std::size_t count = frames.size();
    for (std::size_t i = 0; i < count && !on.any; ++i) {
      if (!meets(way, frames[i]) || fields[i]->freeWithin(a) > (b - a).norm()) continue;
      const std::uint64_t bit = contact_only & std::uint64_t{1} << i;
      on.contact_only |= bit;
      on.any = bit == 0;
    }
  };
  look(graph.scalar_fields, graph.scalar_frames, graph.contact_only);
  look(graph.vector_fields, graph.vector_frames, 0);
  return on;
}

/// Returns true if properties were read before, only the hand can have moved since the last tick,
/// and no trace is requested.
bool rests(const Tick& tick) noexcept {
  return tick.scene.still && tick.proxy.known && !tick.changed && tick.trace == nullptr;
}

}  // namespace

bool moveProxy(Tick& tick, double time) noexcept {
  Proxy& proxy = tick.proxy;
  Bodies& bodies = tick.around.bodies;
  const bool only_hand = rests(tick);
  const bool was_at_hand = only_hand && proxy.offset.isZero(0.0);
  const OnWay on = was_at_hand ? fieldsOnWay(tick) : OnWay{true};
  if (!on.any && proxy.free_ticks >= kSettled &&
      (on.contact_only == 0 || isPathClear(tick, on.contact_only))) {
    proxy.beyond += tick.probe - proxy.position;
    proxy.position = tick.probe;
    tick.report.solver = SolverKind::kClosedForm;
    return true;
  }
  const int moves = bodies.empty() ? 1
                                   : bodies.plan(tick.felt(), time, proxy.position, tick.probe,
                                                 tick.scene.step.max_substeps, tick.report);
  if (!proxy.known) initContacts(tick);
  if (!tick.scene.parts.empty()) meetParts(tick);
  const Vec3 hand = tick.probe;
  const Vec3 hand_before = proxy.position - proxy.offset;
  const int slices = std::max(moves, handSlices(tick, hand_before));
  const Vec3 came = (hand - hand_before) / slices;
  Slice last = Slice::kWaiting;
  for (int slice = 1; slice <= slices && last != Slice::kSpoilt; ++slice) {
    // A slice reuses neither the reading nor the primitives of the last one if more than the hand
    // has moved.
    proxy.arrived = proxy.arrived && only_hand;
    if (!bodies.empty()) moveBodies(tick, slice, slices);
    tick.probe = hand - (slices - slice) * came;
    proxy.offset = proxy.position - tick.probe;
    last = follow(tick, slices - slice);
    proxy.arrived = last == Slice::kArrived;
  }
  eachMode(tick.felt(), [&](const Mode& mode, ModeMemory& memory, const Felt&, std::size_t) {
    settle(mode, proxy.position, last == Slice::kArrived, memory);
  });
  bodies.arrive();
  const bool stayed = !on.any && tick.report.primitives == 0 && proxy.offset.isZero(0.0);
  proxy.free_ticks = stayed ? proxy.free_ticks + 1 : 0;
  return last != Slice::kSpoilt;
}

}  // namespace palpate
