/// Modes of a vector volume that add planes and lines: follow, front shape and vortex tube.
#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

#include "palpate/engine/modes/mode_place.h"

namespace palpate {
namespace {

/// A flow has no vortex if |curl v| times a voxel is less than this share of |v|. Up to twice this
/// share, the strength of the mode rises from zero.
constexpr double kNoVortex = 1e-5;

/// Returns the unit direction of a primitive that is anchored at the proxy. This is the mean
/// (trapezoidal rule) of `before`, the direction at the proxy, and q, the direction at the reading.
/// If there is no new reading, if the reading is at the proxy, or if before.q is not above 0, sets
/// `before` to q and returns q.
Vec3 midway(const EvaluationPoint& stand, const Vec3& q, Vec3& before) noexcept {
  const bool here = stand.foreseen || stand.read == stand.proxy;
  if (here || !(before.dot(q) > 0.0)) before = q;
  return here ? q : Vec3((before + q).normalized());
}

bool nothing(Vec3& before) noexcept {
  before.setZero();
  return true;
}

/// Returns how a plane through `position` varies with the place x of the reading. The normal turns
/// half as much as the direction at the reading (midway). Newton's step solves n(x + step) . (x +
/// step - position) = 0, so (n + turn^T w) . step = -n . w with w = x - position.
Variation planeVaries(const EmitContext& place, const Vec3& position, const Vec3& normal,
                      const Mat3& turn) noexcept {
  Variation plane;
  plane.turn = 0.5 * turn;
  const Vec3 way = place.stand.read - position;
  plane.across = normal + plane.turn.transpose() * way;
  plane.height = normal.dot(way);
  return plane;
}

Variation opposed(const Variation& plane) noexcept {
  return {-plane.turn, Vec3::Zero(), -plane.across, -plane.height};
}

bool addSlab(const EmitContext& place, const Vec3& position, const Vec3& normal, double strength,
             const Variation& plane) noexcept {
  return place.add(PrimitiveKind::kPlane, position, normal, strength, plane) &&
         place.add(PrimitiveKind::kPlane, position, -normal, strength, opposed(plane));
}

}  // namespace

bool emit(const FollowMode& mode, const EmitContext& place, FollowMemory& memory) noexcept {
  const Properties::Vector& v = place.vector(mode.vector);
  Vec3 q;
  if (!v.inside || !unit(v.value, q)) return nothing(memory.before);
  return place.add(PrimitiveKind::kLine, midway(place.stand, q, memory.before),
                   mode.strength(place.at));
}

bool emit(const FrontShapeMode& mode, const EmitContext& place, FrontShapeMemory& memory) noexcept {
  const Properties::Vector& v = place.vector(mode.vector);
  Vec3 q;
  if (!v.inside || !unit(v.value, q)) {
    memory.placed = false;
    return nothing(memory.before);
  }
  // Snap-drag: the remembered plane holds a proxy that is pulled off its front, up to the distance
  // `snap`. Then the proxy is released until it rests. Otherwise the front goes through the proxy.
  constexpr double kOn = 1e-3;  // a proxy within this share of the snap distance is on its front
  const Vec3& p = place.stand.proxy;
  const double off = memory.placed ? memory.normal.dot(p - memory.anchor) : 0.0;
  const double away = mode.two_sided ? std::abs(off) : -off;
  if (memory.placed && away > mode.snap) memory.let_go = true;
  if (memory.let_go) {
    memory.placed = false;
    return true;
  }
  Mat3 turn = Mat3::Zero();
  if (!memory.placed || away <= kOn * mode.snap) {
    memory.anchor = p;
    memory.normal = midway(place.stand, q, memory.before);
    memory.placed = mode.snap > 0.0;
    turn = turnOf(v.value, v.jacobian);
  }
  const double strength = mode.strength(place.at);
  const Variation plane = planeVaries(place, memory.anchor, memory.normal, turn);
  if (mode.two_sided) return addSlab(place, memory.anchor, memory.normal, strength, plane);
  return place.add(PrimitiveKind::kPlane, memory.anchor, memory.normal, strength, plane);
}

void settle(const FrontShapeMode& /*mode*/, const Vec3& /*proxy*/, bool arrived,
            FrontShapeMemory& memory) noexcept {
  if (arrived) memory.let_go = false;
}

bool emit(const VortexTubeMode& mode, const EmitContext& place, VortexTubeMemory& memory) noexcept {
  const Properties::Vector& v = place.vector(mode.vector);
  const Vec3& curl = place.vector(mode.curl).value;
  Vec3 core;
  if (!v.inside || !unit(curl, core)) return nothing(memory.before);
  // spin: |curl v| times a voxel, in the unit of v.
  const double spin = curl.norm() * mode.voxel / mode.metres_per_unit;
  const double turning = std::clamp((spin / v.value.norm() - kNoVortex) / kNoVortex, 0.0, 1.0);
  const double strength =
      v.value.norm() > 0.0 ? turning * mode.strength(place.at) : mode.strength(place.at);
  const Vec3 outwards = v.value.cross(core);
  const double radius = 2.0 * outwards.norm() / spin;  // [voxels]
  // Between one and two voxels from the core, the line's share falls from 1 to 0, and the planes
  // get the rest.
  Vec3 radial;
  const double line = unit(outwards, radial) ? std::clamp(2.0 - radius, 0.0, 1.0) : 1.0;
  if (!place.add(PrimitiveKind::kLine, core, line * strength)) return false;
  if (line >= 1.0) return nothing(memory.before);
  Mat3 turned;  // d (v x core)/dx
  for (int j = 0; j < 3; ++j) turned.col(j) = v.jacobian.col(j).cross(core);
  const Vec3& p = place.stand.proxy;
  const Vec3 normal = midway(place.stand, radial, memory.before);
  const Variation plane = planeVaries(place, p, normal, turnOf(outwards, turned));
  return addSlab(place, p, normal, (1.0 - line) * strength, plane);
}

}  // namespace palpate
