/// Modes of a scalar volume: surface and isosurface.
#include <algorithm>

#include "palpate/engine/modes/mode_place.h"

namespace palpate {
namespace {

/// A surface counts as pushed through if the proxy is farther than this behind it [voxels].
constexpr double kYield = 0.05;
/// A proxy has left the surface if it is farther than this in front of the plane [voxels].
constexpr double kLeft = 1e-4;
/// A remembered plane holds up to this distance from its anchor [voxels].
constexpr double kPlaneHolds = 4.0;

/// Puts the plane through the proxy, as in the paper. Once the plane has held the proxy, puts it on
/// V = Va.
void see(const SurfaceMode& mode, const EmitContext& place, SurfaceMemory& memory) noexcept {
  Contact& contact = memory.contact;
  contact.seen = false;
  const double value = place.scalar(mode.skin.value).value;
  if (!memory.holds) memory.captured = false;
  if (memory.holds && !memory.captured) {
    memory.level = value;
    memory.captured = true;
  }
  const SurfaceReading sight =
      look(mode.skin, memory.captured ? memory.level : value, place.at, place.stand.seam);
  if (!sight.clear || mode.strength(place.at) <= 0.0) {
    leave(contact);
    return;
  }
  if (memory.captured) {
    palpate::place(contact, mode.skin, sight, place.stand.read);
    return;
  }
  leave(contact);
  contact.anchor = place.stand.proxy;
  contact.normal = contact.across = sight.normal;
  contact.height = sight.normal.dot(place.stand.read - place.stand.proxy);
  contact.seen = true;
  contact.placed = true;
}

/// Returns the strength [N]. If the proxy is outside, this is the strength at V = level.
double strengthOf(const IsosurfaceMode& mode, const EmitContext& place, Side side) noexcept {
  if (side != Side::kOutside) return mode.strength(place.at);
  return mode.strength.at(place.at, mode.skin.value, mode.level);
}

/// Returns the gradient of the strength [N/m]; zero until the surface was pushed through. Neglects
/// the change of `share`, because a surface that fades releases the proxy at once.
Vec3 slopeOf(const IsosurfaceMode& mode, const EmitContext& place,
             const IsosurfaceMemory& memory) noexcept {
  if (memory.side == Side::kOutside) return Vec3::Zero();
  return memory.share * mode.strength.slope(place.at);
}

Side nextSide(const IsosurfaceMode& mode, const EmitContext& place, const SurfaceReading& sight,
              bool free, IsosurfaceMemory& memory) noexcept {
  const Contact& contact = memory.contact;
  switch (memory.side) {
    case Side::kUnknown: {
      // A proxy on the surface, within rounding or light pressure, is outside.
      const bool resting = sight.clear && sight.height > -kYield;
      return free || resting ? Side::kOutside : Side::kInside;
    }
    case Side::kInside:
      return free ? Side::kOutside : Side::kInside;
    case Side::kOutside: {
      // A surface holds if it has data, strength and a plane, seen or remembered.
      if (free && !contact.touched) return Side::kOutside;
      const bool near = contact.placed &&
                        (place.stand.read - contact.anchor).norm() <= kPlaneHolds * mode.skin.voxel;
      const bool holds =
          sight.data && strengthOf(mode, place, Side::kOutside) > 0.0 && (sight.clear || near);
      return holds ? Side::kOutside : Side::kInside;
    }
    case Side::kYielded: {
      if (free) return Side::kOutside;
      // The plane stays, as in figure 6 d of the paper, also without data: in a level set, the band
      // may end before `depth`. Behind `depth` its strength fades over a voxel.
      const double past = contact.normal.dot(contact.anchor - place.stand.read);
      memory.share = std::clamp(1.0 - (past - mode.depth) / mode.skin.voxel, 0.0, 1.0);
      return memory.share <= 0.0 ? Side::kInside : Side::kYielded;
    }
  }
  return memory.side;
}

void see(const IsosurfaceMode& mode, bool free, const EmitContext& place,
         IsosurfaceMemory& memory) noexcept {
  Contact& contact = memory.contact;
  contact.seen = false;
  contact.walls = place.stand.seam == nullptr ? 1.0 : place.stand.seam->walls;
  memory.share = 1.0;
  const SurfaceReading sight = look(mode.skin, mode.level, place.at, place.stand.seam);
  memory.side = nextSide(mode, place, sight, free, memory);
  if (memory.side == Side::kYielded) {
    drag(contact, mode.skin, sight, place.stand.read);
    return;
  }
  if (contact.placed && memory.side == Side::kOutside && !free && !sight.clear) {
    contact.touched = false;
    return;
  }
  const bool meets = contact.placed || contact.touched || !free;
  if (memory.side == Side::kInside || !meets || !sight.clear) {
    leave(contact);
    return;
  }
  palpate::place(contact, mode.skin, sight, place.stand.read);
}

}  // namespace

bool emit(const SurfaceMode& mode, const EmitContext& place, SurfaceMemory& memory) noexcept {
  Contact& contact = memory.contact;
  contact.plane = -1;
  if (!place.stand.foreseen) {
    see(mode, place, memory);
  } else if (!memory.captured && !memory.holds) {
    contact.anchor = place.stand.proxy;
  }
  const Properties::Vector& gradient = place.vector(mode.skin.gradient);
  if (!gradient.inside || gradient.value.isZero(0.0)) return true;
  const bool room =
      !contact.placed || addContact(contact, mode.strength(place.at), mode.strength.slope(place.at),
                                    mode.friction(place.at), place.stand.proxy, place.set);
  return place.add(PrimitiveKind::kPoint, Vec3::UnitX(), mode.viscosity(place.at)) && room;
}

bool emit(const IsosurfaceMode& mode, const EmitContext& place, IsosurfaceMemory& memory) noexcept {
  memory.contact.plane = -1;
  // The sign of V - V0 counts outside the data as well: the background is free or solid.
  const Properties::Scalar& value = place.scalar(mode.skin.value);
  const bool free = mode.skin.sign * (value.value - mode.level) >= 0.0;
  if (!place.stand.foreseen) see(mode, free, place, memory);
  bool room = true;
  if (!free && value.inside && memory.side != Side::kOutside) {
    room = place.add(PrimitiveKind::kPoint, Vec3::UnitX(), mode.viscosity(place.at));
  }
  if (!memory.contact.placed) return room;
  const double strength = memory.share * strengthOf(mode, place, memory.side);
  const double friction = std::min(mode.friction(place.at) * memory.contact.walls, kMostFriction);
  return addContact(memory.contact, strength, slopeOf(mode, place, memory), friction,
                    place.stand.proxy, place.set) &&
         room;
}

SurfaceAhead ahead(const IsosurfaceMode& mode, IsosurfaceMemory& memory) noexcept {
  if (memory.side != Side::kOutside || memory.contact.load == Load::kYielding) return {};
  return {&mode.skin, &memory.contact, mode.level, &mode.strength};
}

void settle(const IsosurfaceMode& mode, const Vec3& proxy, bool /*arrived*/,
            IsosurfaceMemory& memory) noexcept {
  Contact& contact = memory.contact;
  if (memory.side != Side::kOutside || !contact.placed) return;
  const double past = contact.normal.dot(contact.anchor - proxy) / mode.skin.voxel;
  if (contact.load == Load::kYielding && past > kYield) {
    memory.side = Side::kYielded;
  } else if (contact.load == Load::kNone && past < -kLeft) {
    leave(contact);
  }
}

}  // namespace palpate
