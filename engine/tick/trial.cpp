#include "palpate/engine/tick/trial.h"

#include <algorithm>
#include <limits>

#include "palpate/engine/tick/iteration.h"
#include "palpate/engine/tick/rail.h"
#include "palpate/engine/tick/sweep.h"

namespace palpate {
namespace {

/// A reading is valid at a target within this share of the distance that the proxy may move.
constexpr double kNearShare = 0.25;

/// Returns the distance that the proxy may move from a before properties are read again [m]. This
/// is a voxel of the finest volume that the path to b can reach. The distance is larger in empty
/// parts of volumes, and infinite without a volume. For moving volumes see Bodies::reachFrom.
double reachFrom(const Tick& tick, const Iteration& now, const Vec3& a, const Vec3& b) noexcept {
  const Bodies& bodies = tick.around.bodies;
  if (!bodies.empty()) return bodies.reachFrom(tick.felt(), a, b, now.read);
  const Box way{a.cwiseMin(b), a.cwiseMax(b)};
  double reach = std::numeric_limits<double>::infinity();
  const double length = (b - a).norm();
  const auto meet = [&](const std::vector<FieldFrame>& frames, const auto& fields) {
    std::size_t i = 0;
    for (const FieldFrame& frame : frames) {
      const auto& field = *fields[i++];
      if (!meets(way, frame)) continue;
      const double free = length > frame.voxel ? field.freeWithin(a) : 0.0;
      reach = std::min(reach, std::max(frame.voxel, free));
    }
  };
  for (const Felt& felt : tick.felt()) {
    meet(felt.graph().scalar_frames, felt.graph().scalar_fields);
    meet(felt.graph().vector_frames, felt.graph().vector_fields);
  }
  return reach;
}

/// Returns a lower bound of reachFrom() [m]: half a voxel of the finest volume.
double leastReach(const Tick& tick) noexcept {
  double finest = std::numeric_limits<double>::infinity();
  for (const Felt& felt : tick.felt()) finest = std::min(finest, felt.graph().finest);
  return 0.5 * finest;
}

/// Cuts a trial step that would reach parts that were not chosen. Primitives that push, and volumes
/// that move, can take the proxy beyond the hand.
void stayNear(Tick& tick, const Vec3& from, Trial& trial) noexcept {
  const double share = tick.around.near.knownShare(from, trial.end);
  trial.strays = share < 1.0;
  if (!trial.strays) return;
  constexpr double kShort = 0.99;
  trial.end = from + kShort * share * (trial.end - from);
  trial.complete = trial.near = false;
  trial.cut = true;
  ++tick.strayed;
}

/// Returns the point nearest to p on the path from a to b [m]. If the path adds no energy, neither
/// does a part of it.
Vec3 onWay(const Vec3& a, const Vec3& b, const Vec3& p) noexcept {
  const Vec3 way = b - a;
  const double length = way.squaredNorm();
  return length > 0.0 ? Vec3(a + std::clamp((p - a).dot(way) / length, 0.0, 1.0) * way) : a;
}

}  // namespace

Trial advance(Tick& tick, Iteration& now, bool unread) noexcept {
  const Bodies& bodies = tick.around.bodies;
  const Vec3& target = now.to.target;
  Trial trial{target};
  const Vec3& from = now.read ? now.read_at : tick.proxy.position;
  const Vec3 line = target - from;
  const double length = line.norm();
  double reach = unread ? std::numeric_limits<double>::infinity() : leastReach(tick);
  if (!unread && (!now.rail.laid || length > kNearShare * reach)) {
    reach = reachFrom(tick, now, from, target);
  }
  trial.near = length <= kNearShare * reach;
  trial.reach = reach;
  const double trusted = now.trust.radius;
  if (length > trusted && trusted < reach && !steady(tick, now)) {
    trial.complete = false;
    trial.trusted = true;
    trial.end = from + (trusted / length) * line;
  } else if (!(length <= reach)) {
    trial.complete = false;
    trial.cut = true;
    if (bodies.empty() || now.read ||
        !bodies.follow(tick.felt(), tick.proxy.position, target, trial.end)) {
      trial.end = from + (reach / length) * line;
      if (anchored(tick.balance)) trial.end = onWay(tick.proxy.position, now.to.proxy, trial.end);
    }
  }
  if (!now.rail.laid) layRail(tick, now.to.proxy, now.rail, trial);
  if (!tick.scene.parts.empty()) stayNear(tick, from, trial);
  sweep(tick, now, trial);
  return trial;
}

}  // namespace palpate
