#include "engine/mode.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

namespace palpate {
namespace {

using Contact = ModeMemory::Contact;

/// An isosurface is placed where it is seen from at most this far off, in voxels.
constexpr double kSight = 2.0;
/// A proxy this near its surface is on it: kinks that differ by rounding only are one [voxels].
constexpr double kOnIt = 1e-9;
/// Two walls whose normals' cosine is less are two walls.
constexpr double kTurn = 0.95;
/// A flow that turns by less than this share of its speed over a voxel has no vortex: rounding.
constexpr double kNoVortex = 1e-5;
/// Pushed this far through its surface, a proxy has left it [voxels].
constexpr double kYield = 0.05;

/// v/|v| if that is a direction.
bool unit(const Vec3& v, Vec3& direction) noexcept {
  const double length = v.norm();
  if (!(length > 1e-300) || !std::isfinite(length)) return false;
  direction = v / length;
  return true;
}

bool add(PrimitiveSet& set, PrimitiveKind kind, const Vec3& position, const Vec3& direction,
         double strength) noexcept {
  return strength <= 0.0 || set.tryAdd({kind, position, direction, strength});
}

/// A plane, and its friction through p. Without load the friction is a line of no strength: the set
/// of a contact stays the same from tick to tick.
bool addSurface(PrimitiveSet& set, const Vec3& position, const Vec3& normal, double strength,
                double friction, const Vec3& p) noexcept {
  if (strength <= 0.0) return true;
  if (!set.tryAdd({PrimitiveKind::kPlane, position, normal, strength})) return false;
  return friction <= 0.0 || set.tryAddFriction(p, friction);
}

/// Two opposed planes: held both ways along the normal.
bool addSlab(PrimitiveSet& set, const Vec3& position, const Vec3& normal,
             double strength) noexcept {
  return add(set, PrimitiveKind::kPlane, position, normal, strength) &&
         add(set, PrimitiveKind::kPlane, position, -normal, strength);
}

/// What an emit() below works with.
struct Place {
  const Properties& at;
  const Vec3& p;
  const Vec3& probe;
  ModeMemory& memory;
  PrimitiveSet& set;
  const Pose* pose;

  [[nodiscard]] const Properties::Scalar& scalar(int i) const noexcept {
    return at.scalars[static_cast<std::size_t>(i)];
  }
  [[nodiscard]] const Properties::Vector& vector(int i) const noexcept {
    return at.vectors[static_cast<std::size_t>(i)];
  }
  bool add(PrimitiveKind kind, const Vec3& direction, double strength) const noexcept {
    return palpate::add(set, kind, p, direction, strength);
  }
};

bool emit(const ForceMode& mode, const Place& place) noexcept {
  const Properties::Vector& v = place.vector(mode.vector);
  Vec3 q;
  if (!v.inside || !unit(v.value, q)) return true;
  return place.add(PrimitiveKind::kForce, mode.sign * q, mode.strength(place.at));
}

bool emit(const ViscosityMode& mode, const Place& place) noexcept {
  if (!place.scalar(mode.scalar).inside) return true;
  return place.add(PrimitiveKind::kPoint, Vec3::UnitX(), mode.strength(place.at));
}

bool emit(const SurfaceMode& mode, const Place& place) noexcept {
  const Properties::Vector& gradient = place.vector(mode.gradient);
  Vec3 q;  // outward normal
  if (!gradient.inside || !unit(mode.sign * gradient.value, q)) return true;
  const bool room =
      addSurface(place.set, place.p, q, mode.strength(place.at), mode.friction(place.at), place.p);
  return place.add(PrimitiveKind::kPoint, q, mode.viscosity(place.at)) && room;
}

bool emit(const FollowMode& mode, const Place& place) noexcept {
  const Properties::Vector& v = place.vector(mode.vector);
  Vec3 q;
  if (!v.inside || !unit(v.value, q)) return true;
  return place.add(PrimitiveKind::kLine, q, mode.strength(place.at));
}

bool emit(const FrontShapeMode& mode, const Place& place) noexcept {
  const Properties::Vector& v = place.vector(mode.vector);
  ModeMemory& memory = place.memory;
  Vec3 q;
  if (!v.inside || !unit(v.value, q)) {
    memory.placed = false;
    return true;
  }
  // Snap-drag: off its front by force, the proxy is still held by it, until it is let go. Else the
  // front is at p.
  constexpr double kOn = 1e-3;  // of the snap distance
  const double off = memory.placed ? memory.normal.dot(place.p - memory.anchor) : 0.0;
  const double away = mode.two_sided ? std::abs(off) : -off;
  if (memory.placed && away > mode.snap) memory.let_go = true;
  if (memory.let_go) {
    memory.placed = false;
    return true;
  }
  if (!memory.placed || away <= kOn * mode.snap) {
    memory.anchor = place.p;
    memory.normal = q;
    memory.placed = mode.snap > 0.0;
  }
  const double strength = mode.strength(place.at);
  if (mode.two_sided) return addSlab(place.set, memory.anchor, memory.normal, strength);
  return add(place.set, PrimitiveKind::kPlane, memory.anchor, memory.normal, strength);
}

bool emit(const VortexTubeMode& mode, const Place& place) noexcept {
  const Properties::Vector& v = place.vector(mode.vector);
  const Vec3& curl = place.vector(mode.curl).value;
  Vec3 core;
  if (!v.inside || !unit(curl, core)) return true;
  // What the flow turns by over a voxel: of less than rounding nothing is felt.
  const double spin = curl.norm() * mode.voxel / mode.metres_per_unit;
  const double turning = std::clamp((spin / v.value.norm() - kNoVortex) / kNoVortex, 0.0, 1.0);
  const double strength =
      v.value.norm() > 0.0 ? turning * mode.strength(place.at) : mode.strength(place.at);
  const Vec3 outwards = v.value.cross(core);
  const double radius = 2.0 * outwards.norm() / spin;  // in voxels
  // From the core's line to the tube's planes over a voxel.
  Vec3 radial;
  const double line = unit(outwards, radial) ? std::clamp(2.0 - radius, 0.0, 1.0) : 1.0;
  if (!place.add(PrimitiveKind::kLine, core, line * strength)) return false;
  return line >= 1.0 || addSlab(place.set, place.p, radial, (1.0 - line) * strength);
}

bool emit(const GuideMode& mode, const Place& place) noexcept {
  Primitive guide{mode.shape, mode.position, mode.direction};
  if (place.pose != nullptr) {
    guide.position = (*place.pose)(mode.position);
    guide.direction = place.pose->rotation * mode.direction;
  }
  if (!(distanceTo(guide, place.p) <= mode.snap)) return true;
  const double distance = distanceTo(guide, place.probe) / mode.metres_per_unit;
  const double strength = mode.strength(place.at, distance);
  return add(place.set, guide.kind, guide.position, guide.direction, strength);
}

bool emit(const UserMode& mode, const Place& place) noexcept {
  return mode.place(mode.state.get(), {place.at, mode.reads, place.p, place.probe}, place.set);
}

/// Where the surface is, seen from p.
struct Sight {
  bool clear = false;   ///< Data, a normal, and the surface within kSight.
  double height = 0.0;  ///< Signed distance of p from the surface, > 0 on the free side [m].
  Vec3 normal = Vec3::UnitX();
};

Sight look(const IsosurfaceMode& mode, const Properties& at) noexcept {
  Sight sight;
  const Properties::Scalar& value = at.scalars[static_cast<std::size_t>(mode.value)];
  const Vec3& gradient = at.vectors[static_cast<std::size_t>(mode.gradient)].value;
  const Vec3& own = at.vectors[static_cast<std::size_t>(mode.cell_gradient)].value;
  if (!value.inside || !unit(mode.sign * gradient, sight.normal)) return sight;
  // The slope that V really has along the normal, where that is not degenerate.
  double slope = mode.sign * own.dot(sight.normal);
  if (!(slope > 0.3 * own.norm())) slope = gradient.norm();
  sight.height = mode.sign * (value.value - mode.level) / slope * mode.metres_per_unit;
  sight.clear = std::abs(sight.height) <= kSight * mode.voxel;
  return sight;
}

/// The surface at p is another wall than the one remembered. If p, moved along that one, is behind
/// the new one, they make a concave edge, and both stay; before it, the edge is convex and was
/// left.
void meetWalls(const Sight& sight, ModeMemory& memory) noexcept {
  if (sight.normal.dot(memory.normal) >= kTurn) return;
  const bool back = memory.cornered && sight.normal.dot(memory.other_normal) >= kTurn;
  memory.cornered = back || sight.height < 0.0;
  memory.other_anchor = memory.anchor;
  memory.other_normal = memory.normal;
}

bool emit(const IsosurfaceMode& mode, const Place& place) noexcept {
  const auto& [at, p, probe, memory, set, pose] = place;
  // The sign of V - V0 counts outside the data as well: background is free or solid like the rest.
  const Properties::Scalar& value = place.scalar(mode.value);
  const double side = mode.sign * (value.value - mode.level);
  const bool free = side >= 0.0;
  const Sight sight = look(mode, at);

  // Which side is the proxy on, and may the surface act?
  double share = 1.0;
  switch (memory.contact) {
    case Contact::kUnknown: {
      // On the surface, to rounding or a light press, is outside.
      const bool resting = sight.clear && sight.height > -kYield * mode.voxel;
      memory.contact = free || resting ? Contact::kOutside : Contact::kInside;
      break;
    }
    case Contact::kInside:
      if (free) memory.contact = Contact::kOutside;
      break;
    case Contact::kOutside:
      // Nothing holds where the strength is zero.
      if (!free && (!sight.clear || mode.strength(at) <= 0.0)) memory.contact = Contact::kInside;
      break;
    case Contact::kYielded: {
      if (free) {
        memory.contact = Contact::kOutside;
        break;
      }
      // Fig. 6 d: the plane stays; it fades over one voxel once the proxy is `depth` past it.
      const double past = memory.normal.dot(memory.anchor - p);
      share = std::clamp(1.0 - (past - mode.depth) / mode.voxel, 0.0, 1.0);
      if (share <= 0.0) memory.contact = Contact::kInside;
      break;
    }
  }
  if (memory.contact != Contact::kOutside) memory.placed = memory.cornered = false;
  bool room = true;
  if (!free && value.inside && memory.contact != Contact::kOutside) {
    room = place.add(PrimitiveKind::kPoint, Vec3::UnitX(), mode.viscosity(at));
  }
  if (memory.contact == Contact::kInside) return room;

  // The plane: on the surface where it is seen, else where it was while pushed through. Deep in a
  // thin wall the normal turns over: that is the other side, not the surface pushed through.
  const bool same = memory.contact == Contact::kOutside || sight.normal.dot(memory.normal) > 0.5;
  if (sight.clear && same) {
    const bool on_it = std::abs(sight.height) < kOnIt * mode.voxel;
    const Vec3 anchor = on_it ? p : Vec3(p - sight.height * sight.normal);
    if (memory.placed) meetWalls(sight, memory);
    memory.anchor = anchor;
    memory.normal = sight.normal;
    memory.placed = memory.contact == Contact::kOutside;
  } else if (memory.contact == Contact::kOutside) {
    return room;
  }
  const double strength = share * mode.strength(at);
  const double friction = mode.friction(at);
  // A plane is trusted as far as a voxel from where it was placed.
  memory.cornered = memory.cornered && (p - memory.other_anchor).norm() <= mode.voxel;
  if (memory.cornered) {
    room = addSurface(set, memory.other_anchor, memory.other_normal, strength, friction, p) && room;
  }
  return addSurface(set, memory.anchor, memory.normal, strength, friction, p) && room;
}

}  // namespace

double Transfer::operator()(const Properties& properties, double own) const noexcept {
  double product = factors.empty() ? 0.0 : 1.0;
  for (const Factor& factor : factors) {
    if (factor.scalar < 0) {
      product *= factor.curve(own);
      continue;
    }
    const Properties::Scalar& input = properties.scalars[static_cast<std::size_t>(factor.scalar)];
    product *= input.inside ? factor.curve(input.value) : 0.0;
  }
  return product;
}

double Transfer::anywhere(const Properties& properties) const noexcept {
  double product = factors.empty() ? 0.0 : 1.0;
  for (const Factor& factor : factors) {
    const bool reads = factor.scalar >= 0;
    product *= factor.curve(
        reads ? properties.scalars[static_cast<std::size_t>(factor.scalar)].value : 0.0);
  }
  return product;
}

bool addPrimitives(const Mode& mode, const Properties& properties, const Vec3& p, const Vec3& probe,
                   ModeMemory& memory, PrimitiveSet& set, const Pose* pose) noexcept {
  const std::size_t before = set.size();
  const Place place{properties, p, probe, memory, set, pose};
  const bool room = std::visit([&](const auto& m) { return emit(m, place); }, mode);
  memory.emitted = static_cast<int>(set.size() - before);
  return room;
}

void carry(const Pose& by, ModeMemory& memory) noexcept {
  memory.anchor = by(memory.anchor);
  memory.normal = by.rotation * memory.normal;
  memory.other_anchor = by(memory.other_anchor);
  memory.other_normal = by.rotation * memory.other_normal;
}

void settle(const Mode& mode, const Vec3& proxy, ModeMemory& memory) noexcept {
  memory.let_go = false;
  const auto* iso = std::get_if<IsosurfaceMode>(&mode);
  if (iso == nullptr || memory.contact == Contact::kInside) return;
  const double past = memory.normal.dot(memory.anchor - proxy);
  if (memory.contact == Contact::kOutside && memory.emitted > 0 && past > kYield * iso->voxel) {
    memory.contact = Contact::kYielded;
  }
}

}  // namespace palpate
