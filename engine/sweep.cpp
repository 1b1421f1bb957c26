#include "palpate/engine/sweep.h"

namespace palpate {
namespace {

/// A path along a surface below this length is not swept: the reading sees the surface [voxels].
constexpr double kSeen = 0.1;

/// Where a path first falls through a surface, both in the resting frame of its volume.
Crossing firstFall(const SurfaceAhead& ahead, const Felt& felt, const Vec3& from, const Vec3& to,
                   StepReport& report) noexcept {
  const Graph& graph = felt.graph();
  const Skin& skin = *ahead.skin;
  const auto field = static_cast<std::size_t>(skin.field);
  if (!meets({from.cwiseMin(to), from.cwiseMax(to)}, graph.scalar_frames[field])) return {};
  const double length = (to - from).norm();
  if (length > skin.voxel && graph.scalar_fields[field]->freeWithin(from) > length) return {};
  // A surface without strength stops no path.
  if (!(ahead.strength->at(*felt.properties, skin.value, ahead.level) > 0.0)) return {};
  const Crossing crossing = felt.bound.firstFall(skin, ahead.level, from, to);
  report.walked += crossing.cells;
  return crossing;
}

}  // namespace

void sweep(Tick& tick, const Iteration& now, Trial& trial) noexcept {
  const Vec3& start = now.read ? now.read_at : tick.proxy.position;
  const double length = (trial.end - start).norm();
  double share = 1.0;
  Vec3 end = trial.end;
  Contact* met = nullptr;
  eachMode(tick.felt(), [&](const Mode& mode, ModeMemory& memory, const Felt& felt, std::size_t) {
    const SurfaceAhead ahead = surfaceAhead(mode, memory);
    if (ahead.skin == nullptr) return;
    const auto field = static_cast<std::size_t>(ahead.skin->field);
    const Body* body = tick.around.bodies.of(felt.graph().scalar_motions[field]);
    const Vec3 lift = liftOff(*ahead.contact, ahead.skin->voxel, length);
    // The path to the last reading is known to be free.
    Vec3 from = start + lift;
    Vec3 to = trial.end + lift;
    if (ahead.contact->placed && (to - from).norm() < kSeen * ahead.skin->voxel && now.read) return;
    if (body != nullptr) {
      from = now.read ? Vec3(body->pose.toRest(from) + body->swept)
                      : Vec3(body->from + body->pose.back * lift);
      to = body->pose.toRest(to);
    }
    const Crossing crossing = firstFall(ahead, felt, from, to, tick.report);
    // A path that is all behind the surface begins behind another of its walls, and ends there.
    if (!crossing.found && !crossing.behind) {
      trial.swept = trial.swept && crossing.share >= 1.0;
      return;
    }
    const double at_share = crossing.found ? crossing.share : 0.0;
    if (met != nullptr && at_share >= share) return;
    share = at_share;
    trial.lift = lift;
    const Vec3 at = from + share * (to - from);
    end = body == nullptr ? at : body->pose(at);
    met = ahead.contact;
  });
  if (met == nullptr) return;
  met->touched = true;
  trial.end = end;
  trial.complete = trial.trusted = false;
  trial.swept = trial.met = true;
  // A surface that did not hold the proxy before is new: the proxy has come to it.
  trial.cut = !met->placed;
}

}  // namespace palpate
