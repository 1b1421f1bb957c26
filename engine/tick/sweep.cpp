#include "palpate/engine/tick/sweep.h"

#include <algorithm>
#include <optional>

namespace palpate {
namespace {

/// If a path along a surface is shorter than this [voxels], it is not swept, because the last
/// reading covers it.
constexpr double kSeen = 0.1;

/// Finds the first point where a path passes a surface from the free side, in its resting frame.
Crossing firstFall(const SurfaceAhead& ahead, const Felt& felt, const Vec3& from, const Vec3& to,
                   StepReport& report) noexcept {
  const Graph& graph = felt.graph();
  const SurfaceSource& skin = *ahead.skin;
  const auto field = static_cast<std::size_t>(skin.field);
  if (!meets({from.cwiseMin(to), from.cwiseMax(to)}, graph.scalar_frames[field])) return {};
  const double length = (to - from).norm();
  if (length > skin.voxel && graph.scalar_fields[field]->freeWithin(from) > length) return {};
  // A surface without strength does not stop a path.
  if (!(ahead.strength->at(*felt.properties, skin.value, ahead.level) > 0.0)) return {};
  const Crossing crossing = felt.bound.firstFall(skin, ahead.level, from, to);
  report.walked += crossing.cells;
  return crossing;
}

/// Returns the sum of the lifts of the planes that bear load, at most as long as the longest lift.
/// For a surface without a plane, the path is swept at this lift. So a surface at the same height
/// as the loaded planes does not stop the path. A surface that rises above the lifted path stops
/// it; the next reading detects all lower surfaces.
Vec3 commonLift(const Tick& tick, double length) noexcept {
  Vec3 sum = Vec3::Zero();
  if (tick.balance.surfaces == 0) return sum;
  double longest = 0.0;
  eachSurface(tick.felt(), [&](const Mode& mode, ModeMemory& memory, const Felt&, std::size_t) {
    const ContactReference touch = touchOf(mode, memory);
    if (touch.skin == nullptr || touch.contact->load != Load::kHeld) return;
    const Vec3 lift = liftOff(*touch.contact, touch.skin->voxel, length);
    longest = std::max(longest, lift.norm());
    sum += lift;
  });
  const double norm = sum.norm();
  return norm > longest ? Vec3(longest / norm * sum) : sum;
}

}  // namespace

void sweep(Tick& tick, const Iteration& now, Trial& trial) noexcept {
  const Vec3& start = now.read ? now.read_at : tick.proxy.position;
  const double length = (trial.end - start).norm();
  double share = 1.0;
  Vec3 end = trial.end;
  Contact* met = nullptr;
  std::optional<Vec3> common;
  const auto meet = [&](const Mode& mode, ModeMemory& memory, const Felt& felt, std::size_t) {
    const SurfaceAhead ahead = surfaceAhead(mode, memory);
    if (ahead.skin == nullptr) return;
    const auto field = static_cast<std::size_t>(ahead.skin->field);
    const Body* body = tick.around.bodies.of(felt.graph().scalar_motions[field]);
    const bool placed = ahead.contact->placed;
    if (placed && length < kSeen * ahead.skin->voxel && now.read) return;
    if (!placed && !common) common = commonLift(tick, length);
    Vec3 lift = placed ? liftOff(*ahead.contact, ahead.skin->voxel, length) : *common;
    Vec3 from;
    Vec3 to;
    Crossing crossing;
    bool again = false;
    do {
      // The path starts at the last reading, because the path up to there was swept before.
      from = start + lift;
      to = trial.end + lift;
      if (body != nullptr) {
        from = now.read ? Vec3(body->pose.toRest(from) + body->swept)
                        : Vec3(body->from + body->pose.back * lift);
        to = body->pose.toRest(to);
      }
      crossing = firstFall(ahead, felt, from, to, tick.report);
      // Without a plane, a lifted path that begins behind the surface is swept again without lift.
      const bool behind = crossing.behind || (crossing.found && crossing.share <= 0.0);
      again = !placed && behind && !lift.isZero(0.0);
      if (again) lift.setZero();
    } while (again);
    // A path that is wholly behind the surface began behind another wall of the surface. The step
    // then ends at the start of the path.
    if (!crossing.found && !crossing.behind) {
      trial.swept = trial.swept && crossing.share >= 1.0;
      return;
    }
    const double at_share = crossing.found ? crossing.share : 0.0;
    if (met != nullptr && at_share >= share) return;
    share = at_share;
    trial.lift = placed ? lift : Vec3(Vec3::Zero());
    const Vec3 at = from + share * (to - from);
    end = body == nullptr ? at : body->pose(at);
    met = ahead.contact;
  };
  eachSurface(tick.felt(), meet);
  if (met == nullptr) return;
  met->touched = true;
  trial.end = end;
  trial.complete = trial.trusted = false;
  trial.swept = trial.met = true;
  // If the surface had no plane before, the proxy moves to the surface.
  trial.cut = !met->placed;
}

bool isPathClear(Tick& tick, std::uint64_t fields) noexcept {
  const auto blocks = [&](const Mode& mode, ModeMemory& memory, const Felt& felt, std::size_t) {
    const SurfaceAhead ahead = surfaceAhead(mode, memory);
    const SurfaceSource* skin = ahead.skin != nullptr ? ahead.skin : touchOf(mode, memory).skin;
    if (skin == nullptr || (fields >> skin->field & 1U) == 0) return false;
    if (ahead.skin == nullptr || ahead.contact->placed || ahead.contact->touched) return true;
    const Crossing crossing =
        felt.bound.firstFall(*skin, ahead.level, tick.proxy.position, tick.probe);
    tick.report.walked += crossing.cells;
    return crossing.found || crossing.behind || crossing.share < 1.0;
  };
  return !anySurface(tick.felt(), blocks);
}

}  // namespace palpate
