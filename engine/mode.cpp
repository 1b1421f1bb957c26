#include "engine/mode.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

namespace palpate {
namespace {

using Contact = ModeMemory::Contact;

/// An isosurface is placed where it is seen from at most this far off, in voxels.
constexpr double kSight = 2.0;
/// And its plane is so much nearer to there at a time.
constexpr double kStep = 0.5;
/// A proxy this near its surface is on it: kinks that differ by rounding only are one [voxels].
constexpr double kOnIt = 1e-9;
/// A flow that turns by less than this share of its speed over a voxel has no vortex: rounding.
constexpr double kNoVortex = 1e-5;
/// Pushed this far through its surface, a proxy has left it [voxels].
constexpr double kYield = 0.05;
/// A proxy that is farther before its plane has left it [voxels].
constexpr double kLeft = 1e-4;
/// The way of a proxy along its surface is swept this far above it, as a share of the way, which
/// counts as a voxel at most.
constexpr double kLift = 0.25;

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
  const Stand& stand;
  ModeMemory& memory;
  PrimitiveSet& set;

  [[nodiscard]] const Properties::Scalar& scalar(int i) const noexcept {
    return at.scalars[static_cast<std::size_t>(i)];
  }
  [[nodiscard]] const Properties::Vector& vector(int i) const noexcept {
    return at.vectors[static_cast<std::size_t>(i)];
  }
  bool add(PrimitiveKind kind, const Vec3& direction, double strength) const noexcept {
    return palpate::add(set, kind, stand.proxy, direction, strength);
  }
  /// No direction here: none to go on with either.
  bool nothing() const noexcept {
    memory.before.setZero();
    return true;
  }
  /// The direction of a primitive at the proxy that is to hold until `read`: half way between those
  /// at the two places (the trapezoidal rule). `q`: where properties were read last.
  [[nodiscard]] Vec3 midway(const Vec3& q) const noexcept {
    const bool here = stand.foreseen || stand.read == stand.proxy;
    if (here || !(memory.before.dot(q) > 0.0)) memory.before = q;
    return here ? q : Vec3((memory.before + q).normalized());
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

bool emit(const FollowMode& mode, const Place& place) noexcept {
  const Properties::Vector& v = place.vector(mode.vector);
  Vec3 q;
  if (!v.inside || !unit(v.value, q)) return place.nothing();
  return place.add(PrimitiveKind::kLine, place.midway(q), mode.strength(place.at));
}

bool emit(const FrontShapeMode& mode, const Place& place) noexcept {
  const Properties::Vector& v = place.vector(mode.vector);
  ModeMemory& memory = place.memory;
  Vec3 q;
  if (!v.inside || !unit(v.value, q)) {
    memory.placed = false;
    return place.nothing();
  }
  // Snap-drag: off its front by force, the proxy is still held by it, until it is let go. Else the
  // front is at p.
  constexpr double kOn = 1e-3;  // of the snap distance
  const Vec3& p = place.stand.proxy;
  const double off = memory.placed ? memory.wall.normal.dot(p - memory.wall.anchor) : 0.0;
  const double away = mode.two_sided ? std::abs(off) : -off;
  if (memory.placed && away > mode.snap) memory.let_go = true;
  if (memory.let_go) {
    memory.placed = false;
    return true;
  }
  if (!memory.placed || away <= kOn * mode.snap) {
    memory.wall = {p, place.midway(q)};
    memory.placed = mode.snap > 0.0;
  }
  const Vec3& anchor = memory.wall.anchor;
  const Vec3& normal = memory.wall.normal;
  const double strength = mode.strength(place.at);
  if (mode.two_sided) return addSlab(place.set, anchor, normal, strength);
  return add(place.set, PrimitiveKind::kPlane, anchor, normal, strength);
}

bool emit(const VortexTubeMode& mode, const Place& place) noexcept {
  const Properties::Vector& v = place.vector(mode.vector);
  const Vec3& curl = place.vector(mode.curl).value;
  Vec3 core;
  if (!v.inside || !unit(curl, core)) return place.nothing();
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
  if (line >= 1.0) return place.nothing();
  return addSlab(place.set, place.stand.proxy, place.midway(radial), (1.0 - line) * strength);
}

bool emit(const GuideMode& mode, const Place& place) noexcept {
  Primitive guide{mode.shape, mode.position, mode.direction};
  if (const Pose* pose = place.stand.pose; pose != nullptr) {
    guide.position = (*pose)(mode.position);
    guide.direction = pose->rotation * mode.direction;
  }
  if (!(distanceTo(guide, place.stand.proxy) <= mode.snap)) return true;
  const double distance = distanceTo(guide, place.stand.probe) / mode.metres_per_unit;
  const double strength = mode.strength(place.at, distance);
  return add(place.set, guide.kind, guide.position, guide.direction, strength);
}

bool emit(const UserMode& mode, const Place& place) noexcept {
  return mode.place(mode.state.get(),
                    {place.at, mode.reads, place.stand.proxy, place.stand.probe, place.stand.read,
                     place.stand.foreseen},
                    place.set);
}

/// Where the surface is, seen from where properties were read.
struct Sight {
  bool data = false;    ///< There is a value,
  bool clear = false;   ///< a normal, and the surface is within kSight.
  double height = 0.0;  ///< Along the normal from the surface, > 0 on the free side [voxels].
  Vec3 normal = Vec3::UnitX();
  Vec3 across = Vec3::UnitX();  ///< Of the slope that V really has there,
  double off = 0.0;             ///< the height along that [voxels].
};

Sight look(const Skin& skin, double level, const Place& place) noexcept {
  Sight sight;
  const Properties::Scalar& value = place.scalar(skin.value);
  const Vec3& gradient = place.vector(skin.gradient).value;
  const Vec3& own = place.vector(skin.cell_gradient).value;
  sight.data = value.inside;
  if (!value.inside || !unit(skin.sign * gradient, sight.normal)) return sight;
  // The slope that V really has along the normal, where that is not degenerate.
  double slope = skin.sign * own.dot(sight.normal);
  if (!(slope > 0.0)) slope = gradient.norm();
  const double above = skin.sign * (value.value - level) * skin.metres_per_unit / skin.voxel;
  sight.height = above / slope;
  // How far off it is, by the steeper of the two: deep in a groove the normal points out of it
  // while the cell's slope points across, and what lies along the normal is no distance.
  if (!unit(skin.sign * own, sight.across)) sight.across = sight.normal;
  sight.off = above / std::max(own.norm(), 1e-3 * gradient.norm());
  sight.clear = std::abs(above) <= kSight * std::max(own.norm(), gradient.norm());
  return sight;
}

void forgetWalls(ModeMemory& memory) noexcept {
  memory.placed = memory.touched = false;
}

/// Puts the plane on the surface.
void placeWall(const Skin& skin, const Sight& sight, const Place& place) noexcept {
  ModeMemory& memory = place.memory;
  const Vec3& x = place.stand.read;
  if (memory.placed && !memory.touched && sight.normal.dot(memory.wall.normal) < 0.0) {
    // Turned over without having been met. Behind the surface it is the other side of a thin wall,
    // and the plane stays; before it the proxy is past an edge, and what it meets next is found by
    // its way.
    if (sight.height >= 0.0) forgetWalls(memory);
    return;
  }
  const double height = std::clamp(sight.height, -kStep, kStep);
  const bool on_it = std::abs(height) < kOnIt;
  memory.wall.anchor = on_it ? x : Vec3(x - height * skin.voxel * sight.normal);
  memory.wall.normal = sight.normal;
  memory.wall.across = sight.across;
  memory.wall.height = std::clamp(sight.off, -kStep, kStep) * skin.voxel;
  memory.placed = memory.seen = true;
  memory.touched = false;
}

/// Adds the wall that is remembered.
bool addWall(double strength, double friction, const Place& place) noexcept {
  ModeMemory& memory = place.memory;
  const Wall& wall = memory.wall;
  const std::size_t next = place.set.size();
  const bool room =
      addSurface(place.set, wall.anchor, wall.normal, strength, friction, place.stand.proxy);
  if (place.set.size() > next) memory.plane = static_cast<int>(next);
  return room;
}

/// Paper: through the proxy. Once it has held the proxy, on the surface of that place.
void see(const SurfaceMode& mode, const Place& place) noexcept {
  ModeMemory& memory = place.memory;
  memory.seen = false;
  const Skin& skin = mode.skin;
  if (!memory.holds) memory.captured = false;
  if (memory.holds && !memory.captured) {
    memory.level = place.scalar(skin.value).value;
    memory.captured = true;
  }
  const double level = memory.captured ? memory.level : place.scalar(skin.value).value;
  const Sight sight = look(skin, level, place);
  if (!sight.clear || mode.strength(place.at) <= 0.0) {
    forgetWalls(memory);
    return;
  }
  if (memory.captured) {
    placeWall(skin, sight, place);
    return;
  }
  forgetWalls(memory);
  memory.wall.anchor = place.stand.proxy;
  memory.wall.normal = memory.wall.across = sight.normal;
  memory.wall.height = sight.normal.dot(place.stand.read - place.stand.proxy);
  memory.seen = true;
  memory.placed = true;
}

bool emit(const SurfaceMode& mode, const Place& place) noexcept {
  ModeMemory& memory = place.memory;
  if (!place.stand.foreseen) {
    see(mode, place);
  } else if (!memory.captured && !memory.holds) {
    memory.wall.anchor = place.stand.proxy;
  }
  const Properties::Vector& gradient = place.vector(mode.skin.gradient);
  if (!gradient.inside || gradient.value.isZero(0.0)) return true;
  bool room = true;
  if (memory.placed) {
    room = addWall(mode.strength(place.at), mode.friction(place.at), place);
  }
  return place.add(PrimitiveKind::kPoint, Vec3::UnitX(), mode.viscosity(place.at)) && room;
}

/// Outside, of the surface itself: also where V was read beside it.
double strengthOf(const IsosurfaceMode& mode, const Place& place) noexcept {
  if (place.memory.contact != Contact::kOutside) return mode.strength(place.at);
  return mode.strength.at(place.at, mode.skin.value, mode.level);
}

/// Properties were read near the plane that is remembered.
bool isNear(const Skin& skin, const Place& place) noexcept {
  const ModeMemory& memory = place.memory;
  return memory.placed &&
         (place.stand.read - memory.wall.anchor).norm() <= 2.0 * kSight * skin.voxel;
}

/// Which side is the proxy on, and where is the plane?
void see(const IsosurfaceMode& mode, bool free, const Place& place) noexcept {
  ModeMemory& memory = place.memory;
  memory.seen = false;
  const Skin& skin = mode.skin;
  const Sight sight = look(skin, mode.level, place);
  const bool touched = memory.touched;
  memory.share = 1.0;
  switch (memory.contact) {
    case Contact::kUnknown: {
      // On the surface, to rounding or a light press, is outside.
      const bool resting = sight.clear && sight.height > -kYield;
      memory.contact = free || resting ? Contact::kOutside : Contact::kInside;
      break;
    }
    case Contact::kInside:
      if (free) memory.contact = Contact::kOutside;
      break;
    case Contact::kOutside:
      // Nothing holds where there are no data or no strength, nor where no plane is known. Read too
      // far behind its surface for that to be seen, the plane that is remembered holds, as far from
      // there as a surface is seen.
      if ((!free || touched) && (!sight.data || strengthOf(mode, place) <= 0.0 ||
                                 (!sight.clear && !isNear(skin, place)))) {
        memory.contact = Contact::kInside;
      }
      break;
    case Contact::kYielded: {
      if (free) {
        memory.contact = Contact::kOutside;
        break;
      }
      // Fig. 6 d: the plane stays; it fades over one voxel once the proxy is `depth` past it.
      const double past = memory.wall.normal.dot(memory.wall.anchor - place.stand.read);
      memory.share = std::clamp(1.0 - (past - mode.depth) / skin.voxel, 0.0, 1.0);
      if (memory.share <= 0.0) memory.contact = Contact::kInside;
      break;
    }
  }
  if (memory.contact == Contact::kYielded) {
    // On the surface where that is seen, else where it was while pushed through. Deep in a thin
    // wall the normal turns over: that is the other side, not the surface pushed through.
    const bool near = sight.clear && std::abs(sight.height) <= kSight;
    if (near && sight.normal.dot(memory.wall.normal) > 0.5) {
      memory.wall.anchor = place.stand.read - sight.height * skin.voxel * sight.normal;
      memory.wall.normal = sight.normal;
      memory.wall.across = sight.across;
      memory.wall.height = std::clamp(sight.off, -kStep, kStep) * skin.voxel;
      memory.seen = true;
    }
    return;
  }
  // In contact, or found behind the surface.
  const bool meets = memory.placed || touched || !free;
  if (memory.placed && memory.contact == Contact::kOutside && !free && !sight.clear) {
    memory.touched = false;
    return;
  }
  if (memory.contact == Contact::kInside || !meets || !sight.clear) {
    forgetWalls(memory);
    return;
  }
  placeWall(skin, sight, place);
}

bool emit(const IsosurfaceMode& mode, const Place& place) noexcept {
  ModeMemory& memory = place.memory;
  const Skin& skin = mode.skin;
  // The sign of V - V0 counts outside the data as well: background is free or solid like the rest.
  const Properties::Scalar& value = place.scalar(skin.value);
  const bool free = skin.sign * (value.value - mode.level) >= 0.0;
  if (!place.stand.foreseen) see(mode, free, place);
  bool room = true;
  if (!free && value.inside && memory.contact != Contact::kOutside) {
    room = place.add(PrimitiveKind::kPoint, Vec3::UnitX(), mode.viscosity(place.at));
  }
  if (!memory.placed) return room;
  const double strength = memory.share * strengthOf(mode, place);
  return addWall(strength, mode.friction(place.at), place) && room;
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

double Transfer::at(const Properties& properties, int index, double value) const noexcept {
  double product = factors.empty() ? 0.0 : 1.0;
  for (const Factor& factor : factors) {
    if (factor.scalar < 0 || factor.scalar == index) {
      product *= factor.curve(value);
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

bool addPrimitives(const Mode& mode, const Properties& properties, const Stand& stand,
                   ModeMemory& memory, PrimitiveSet& set) noexcept {
  const std::size_t before = set.size();
  memory.plane = -1;
  const Place place{properties, stand, memory, set};
  const bool room = std::visit([&](const auto& m) { return emit(m, place); }, mode);
  memory.emitted = static_cast<int>(set.size() - before);
  return room;
}

void carry(const Pose& by, ModeMemory& memory) noexcept {
  Wall& wall = memory.wall;
  wall.anchor = by(wall.anchor);
  wall.normal = by.rotation * wall.normal;
  wall.turn = by.rotation * wall.turn * by.rotation.transpose();
  wall.across = by.rotation * wall.across;
  memory.before = by.rotation * memory.before;
}

const Skin* skinOf(const Mode& mode) noexcept {
  if (const auto* surface = std::get_if<SurfaceMode>(&mode)) return &surface->skin;
  if (const auto* iso = std::get_if<IsosurfaceMode>(&mode)) return &iso->skin;
  return nullptr;
}

void weigh(const Mode& mode, std::span<const Primitive> primitives, std::span<const Vec3> forces,
           ModeMemory& memory) noexcept {
  const auto i = static_cast<std::size_t>(memory.plane);
  const bool bears = memory.plane >= 0 && i < primitives.size();
  memory.load = bears ? loadOf(primitives[i], forces[i]) : Load::kNone;
  if (std::holds_alternative<SurfaceMode>(mode)) memory.holds = memory.load == Load::kHeld;
}

void settle(const Mode& mode, const Vec3& proxy, bool arrived, ModeMemory& memory) noexcept {
  if (arrived) memory.let_go = false;
  memory.touched = false;
  const auto* iso = std::get_if<IsosurfaceMode>(&mode);
  if (iso == nullptr || memory.contact != Contact::kOutside || !memory.placed) return;
  const double past = memory.wall.normal.dot(memory.wall.anchor - proxy) / iso->skin.voxel;
  if (memory.load == Load::kYielding && past > kYield) {
    memory.contact = Contact::kYielded;
  } else if (memory.load == Load::kNone && past < -kLeft) {
    forgetWalls(memory);
  }
}

Vec3 liftOff(const IsosurfaceMode& mode, double way, const ModeMemory& memory) noexcept {
  if (!memory.placed) return Vec3::Zero();
  return kLift * std::min(way, mode.skin.voxel) * memory.wall.normal;
}

}  // namespace palpate
