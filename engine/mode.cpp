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
/// Two walls whose normals' cosine is less are two walls.
constexpr double kTurn = 0.99;
/// Where the continuous normal and the cell's own differ by more (their cosine is less) there is an
/// edge, and the cell's own is the surface's.
constexpr double kSharp = 0.9;
/// A flow that turns by less than this share of its speed over a voxel has no vortex: rounding.
constexpr double kNoVortex = 1e-5;
/// Pushed this far through its surface, a proxy has left it [voxels].
constexpr double kYield = 0.05;
/// A balance this near a plane is held by it [voxels].
constexpr double kHeld = 1e-4;
/// A proxy that is farther above its surface is not on it [voxels].
constexpr double kAbove = 0.01;
/// The way of a proxy along its surface is swept this far above it [voxels].
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
  const auto& [anchor, normal] = memory.wall;
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
  bool clear = false;   ///< Data, a normal, and the surface within kSight.
  double height = 0.0;  ///< Signed distance from the surface, > 0 on the free side [voxels].
  double bend = 0.0;    ///< |normal - that of the cell's own polynomial|
  Vec3 normal = Vec3::UnitX();
};

Sight look(const Skin& skin, double level, const Place& place) noexcept {
  Sight sight;
  const Properties::Scalar& value = place.scalar(skin.value);
  const Vec3& gradient = place.vector(skin.gradient).value;
  const Vec3& own = place.vector(skin.cell_gradient).value;
  Vec3 steepest;
  if (!value.inside || !unit(skin.sign * gradient, sight.normal)) return sight;
  // The slope that V really has along the normal, where that is not degenerate.
  if (unit(skin.sign * own, steepest)) {
    if (steepest.dot(sight.normal) < kSharp) sight.normal = steepest;
    sight.bend = (sight.normal - steepest).norm();
  }
  double slope = skin.sign * own.dot(sight.normal);
  if (!(slope > 0.0)) slope = gradient.norm();
  sight.height = skin.sign * (value.value - level) / slope * skin.metres_per_unit / skin.voxel;
  sight.clear = std::abs(sight.height) <= kSight;
  return sight;
}

/// The surface as it is now seen is another wall than the one remembered. If that one led behind
/// the new one, they make a concave edge, and both stay; before it, the edge is convex and was
/// left.
void meetWalls(const Sight& sight, bool touched, ModeMemory& memory) noexcept {
  if (sight.normal.dot(memory.wall.normal) >= kTurn) return;
  const Wall left = memory.wall;
  for (std::size_t i = 0; i < memory.other_count; ++i) {
    if (sight.normal.dot(memory.others[i].normal) < kTurn) continue;
    memory.others[i] = left;  // back on a wall that is known
    return;
  }
  if (!touched && sight.height >= 0.0) {
    memory.other_count = 0;
    return;
  }
  if (memory.other_count == memory.others.size()) {
    std::move(memory.others.begin() + 1, memory.others.end(), memory.others.begin());
    --memory.other_count;
  }
  memory.others[memory.other_count++] = left;
}

/// Forgets the other walls but those that `keep` holds for.
template <class Keep>
void keepOthers(ModeMemory& memory, Keep&& keep) noexcept {
  const auto begin = memory.others.begin();
  const auto end = begin + static_cast<std::ptrdiff_t>(memory.other_count);
  const auto kept = std::remove_if(begin, end, [&](const Wall& other) { return !keep(other); });
  memory.other_count = static_cast<std::size_t>(kept - begin);
}

/// Another wall that still holds the proxy where the surface is lower belongs to a convex edge that
/// the proxy has come over.
void leaveEdges(const Skin& skin, const Sight& sight, const Vec3& x, ModeMemory& memory) noexcept {
  if (sight.height <= kAbove) return;
  keepOthers(memory, [&](const Wall& other) {
    return std::abs(other.normal.dot(x - other.anchor)) >= kAbove * skin.voxel;
  });
}

void forgetWalls(ModeMemory& memory) noexcept {
  memory.placed = memory.touched = false;
  memory.other_count = 0;
  memory.missing = memory.bend = memory.turn = memory.way = 0.0;
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
    memory.read = x;
    memory.missing = memory.bend = memory.turn = 0.0;
    return;
  }
  if (memory.placed) meetWalls(sight, memory.touched, memory);
  if (!memory.touched) leaveEdges(skin, sight, x, memory);
  memory.turn = memory.placed ? (sight.normal - memory.wall.normal).norm() : 0.0;
  memory.way = (x - memory.read).norm() / skin.voxel;
  memory.bend = sight.bend;
  const double height = std::clamp(sight.height, -kStep, kStep);
  memory.missing = std::abs(sight.height - height);
  const bool on_it = std::abs(height) < kOnIt;
  memory.wall = {on_it ? x : Vec3(x - height * skin.voxel * sight.normal), sight.normal};
  memory.read = x;
  memory.placed = true;
  memory.touched = false;
}

/// Adds the walls that are remembered.
bool addWalls(const Skin& skin, double strength, double friction, const Place& place) noexcept {
  ModeMemory& memory = place.memory;
  const Vec3& p = place.stand.proxy;
  // A plane is trusted as far as a voxel from where it was placed.
  keepOthers(memory, [&](const Wall& other) {
    return !((place.stand.read - other.anchor).norm() > skin.voxel);
  });
  bool room = true;
  for (std::size_t i = 0; i < memory.other_count; ++i) {
    const auto& [anchor, normal] = memory.others[i];
    room = addSurface(place.set, anchor, normal, strength, friction, p) && room;
  }
  return addSurface(place.set, memory.wall.anchor, memory.wall.normal, strength, friction, p) &&
         room;
}

/// Paper: through the proxy. Once it has held the proxy, on the surface of that place.
void see(const SurfaceMode& mode, const Place& place) noexcept {
  ModeMemory& memory = place.memory;
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
  memory.wall = {place.stand.proxy, sight.normal};
  memory.read = place.stand.read;
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
    room = addWalls(mode.skin, mode.strength(place.at), mode.friction(place.at), place);
  }
  return place.add(PrimitiveKind::kPoint, Vec3::UnitX(), mode.viscosity(place.at)) && room;
}

/// Outside, of the surface itself: also where V was read beside it.
double strengthOf(const IsosurfaceMode& mode, const Place& place) noexcept {
  if (place.memory.contact != Contact::kOutside) return mode.strength(place.at);
  return mode.strength.at(place.at, mode.skin.value, mode.level);
}

/// Which side is the proxy on, and where is the plane?
void see(const IsosurfaceMode& mode, bool free, const Place& place) noexcept {
  ModeMemory& memory = place.memory;
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
      // Nothing holds where the strength is zero.
      if ((!free || touched) && (!sight.clear || strengthOf(mode, place) <= 0.0)) {
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
    memory.other_count = 0;
    if (sight.clear && sight.normal.dot(memory.wall.normal) > 0.5) {
      memory.wall = {place.stand.read - sight.height * skin.voxel * sight.normal, sight.normal};
      memory.read = place.stand.read;
    }
    return;
  }
  // In contact, or found behind the surface.
  const bool meets = memory.placed || touched || !free;
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
  return addWalls(skin, strength, mode.friction(place.at), place) && room;
}

/// Of a surface's walls the one that x is deepest behind, and how far [m].
double deepest(const Vec3& x, const ModeMemory& memory, std::size_t& which) noexcept {
  double most = memory.wall.normal.dot(memory.wall.anchor - x);
  which = memory.others.size();
  for (std::size_t i = 0; i < memory.other_count; ++i) {
    const double past = memory.others[i].normal.dot(memory.others[i].anchor - x);
    if (!(past > most)) continue;
    most = past;
    which = i;
  }
  return most;
}

double doubtOf(const Skin& skin, const Vec3& x, const ModeMemory& memory) noexcept {
  if (!memory.placed) return 0.0;
  const Vec3& q = memory.wall.normal;
  const Vec3 way = (x - memory.read) / skin.voxel;
  const double down = q.dot(way);
  const double left = (way - down * q).norm();
  constexpr double kLeastWay = 0.05;
  // A plane that does not hold may be short of its surface.
  const bool holds = q.dot(x - memory.wall.anchor) <= kHeld * skin.voxel;
  return left * (memory.bend + 0.5 * memory.turn * left / std::max(memory.way, kLeastWay)) +
         0.1 * memory.bend * std::abs(down) + (holds ? memory.missing : 0.0);
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
  const Place place{properties, stand, memory, set};
  const bool room = std::visit([&](const auto& m) { return emit(m, place); }, mode);
  memory.emitted = static_cast<int>(set.size() - before);
  return room;
}

void carry(const Pose& by, ModeMemory& memory) noexcept {
  const auto move = [&by](Wall& wall) {
    wall.anchor = by(wall.anchor);
    wall.normal = by.rotation * wall.normal;
  };
  move(memory.wall);
  for (Wall& wall : memory.others) move(wall);
  memory.read = by(memory.read);
  memory.before = by.rotation * memory.before;
}

double doubt(const Mode& mode, const Vec3& x, const ModeMemory& memory) noexcept {
  if (const auto* surface = std::get_if<SurfaceMode>(&mode)) {
    return doubtOf(surface->skin, x, memory);
  }
  if (const auto* iso = std::get_if<IsosurfaceMode>(&mode)) {
    return memory.contact == Contact::kOutside ? doubtOf(iso->skin, x, memory) : 0.0;
  }
  return 0.0;
}

void weigh(const Mode& mode, const Vec3& x, ModeMemory& memory) noexcept {
  const auto* surface = std::get_if<SurfaceMode>(&mode);
  if (surface == nullptr) return;
  std::size_t which = 0;
  const double past = memory.placed ? deepest(x, memory, which) : 0.0;
  memory.holds = memory.placed && std::abs(past) <= kHeld * surface->skin.voxel;
}

void settle(const Mode& mode, const Vec3& proxy, const Vec3& x, ModeMemory& memory) noexcept {
  if (proxy == x) memory.let_go = false;
  memory.touched = false;
  const auto* iso = std::get_if<IsosurfaceMode>(&mode);
  if (iso == nullptr || memory.contact != Contact::kOutside || !memory.placed) return;
  std::size_t which = 0;
  const double past = deepest(proxy, memory, which);
  if (which < memory.other_count) std::swap(memory.wall, memory.others[which]);
  std::size_t any = 0;
  if (past > kYield * iso->skin.voxel && deepest(x, memory, any) > kYield * iso->skin.voxel) {
    memory.contact = Contact::kYielded;
  } else if (past < -kHeld * iso->skin.voxel) {
    forgetWalls(memory);
  }
}

void letIn(ModeMemory& memory) noexcept {
  memory.contact = Contact::kInside;
  forgetWalls(memory);
}

double pastWalls(const IsosurfaceMode& mode, const Vec3& x, const ModeMemory& memory) noexcept {
  std::size_t which = 0;
  return memory.placed ? deepest(x, memory, which) / mode.skin.voxel : -1.0;
}

bool givesWay(const IsosurfaceMode& mode, const Vec3& x, const ModeMemory& memory) noexcept {
  return pastWalls(mode, x, memory) > kHeld;
}

double depthOf(const IsosurfaceMode& mode, const Properties& read) noexcept {
  const Skin& skin = mode.skin;
  const auto& value = read.scalars[static_cast<std::size_t>(skin.value)];
  const auto& own = read.vectors[static_cast<std::size_t>(skin.cell_gradient)];
  if (!value.inside || !own.inside) return -1.0;
  const double under = -skin.sign * (value.value - mode.level);
  const double slope = own.value.norm();
  if (!(under > 0.0) || !(slope > 0.0)) return -1.0;
  if (!(mode.strength.at(read, skin.value, mode.level) > 0.0)) return -1.0;
  return under / slope * skin.metres_per_unit / skin.voxel;
}

Vec3 liftOff(const IsosurfaceMode& mode, const ModeMemory& memory) noexcept {
  if (!memory.placed) return Vec3::Zero();
  Vec3 sum = memory.wall.normal;
  for (std::size_t i = 0; i < memory.other_count; ++i) sum += memory.others[i].normal;
  double least = sum.dot(memory.wall.normal);
  for (std::size_t i = 0; i < memory.other_count; ++i) {
    least = std::min(least, sum.dot(memory.others[i].normal));
  }
  // In a slot there is no room to be lifted far.
  constexpr double kFarthest = 2.0;
  const double scale = std::min(1.0 / std::max(least, 1e-3), kFarthest / sum.norm());
  return kLift * mode.skin.voxel * scale * sum;
}

}  // namespace palpate
