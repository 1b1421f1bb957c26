#include "engine/mode.h"

#include <algorithm>
#include <cmath>

namespace palpate {
namespace {

using Contact = ModeMemory::Contact;

/// An isosurface is placed where it is seen from at most this far off, in voxels.
constexpr double kSight = 2.0;
/// A proxy this near its surface is on it: kinks that differ by rounding only are one [voxels].
constexpr double kOnIt = 1e-9;
/// Two walls whose normals' cosine is less are two walls.
constexpr double kTurn = 0.95;
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

bool emit(const ForceMode& mode, const Properties& at, const Vec3& p, ModeMemory& /*memory*/,
          PrimitiveSet& set) noexcept {
  const Properties::Vector& v = at.vectors[static_cast<std::size_t>(mode.vector)];
  Vec3 q;
  if (!v.inside || !unit(v.value, q)) return true;
  return add(set, PrimitiveKind::kForce, p, mode.sign * q, mode.strength(at));
}

bool emit(const ViscosityMode& mode, const Properties& at, const Vec3& p, ModeMemory& /*memory*/,
          PrimitiveSet& set) noexcept {
  if (!at.scalars[static_cast<std::size_t>(mode.scalar)].inside) return true;
  return add(set, PrimitiveKind::kPoint, p, Vec3::UnitX(), mode.strength(at));
}

bool emit(const SurfaceMode& mode, const Properties& at, const Vec3& p, ModeMemory& /*memory*/,
          PrimitiveSet& set) noexcept {
  const Properties::Vector& gradient = at.vectors[static_cast<std::size_t>(mode.gradient)];
  Vec3 q;  // outward normal
  if (!gradient.inside || !unit(gradient.value, q)) return true;
  return add(set, PrimitiveKind::kPlane, p, mode.sign * q, mode.strength(at));
}

bool emit(const FollowMode& mode, const Properties& at, const Vec3& p, ModeMemory& /*memory*/,
          PrimitiveSet& set) noexcept {
  const Properties::Vector& v = at.vectors[static_cast<std::size_t>(mode.vector)];
  Vec3 q;
  if (!v.inside || !unit(v.value, q)) return true;
  return add(set, PrimitiveKind::kLine, p, q, mode.strength(at));
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

bool emit(const IsosurfaceMode& mode, const Properties& at, const Vec3& p, ModeMemory& memory,
          PrimitiveSet& set) noexcept {
  // The sign of V - V0 counts outside the data as well: background is free or solid like the rest.
  const double side =
      mode.sign * (at.scalars[static_cast<std::size_t>(mode.value)].value - mode.level);
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
      if (!free && !sight.clear) memory.contact = Contact::kInside;
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
  if (memory.contact == Contact::kInside) return true;

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
    return true;
  }
  const double strength = share * mode.strength(at);
  bool room = true;
  // A plane is trusted as far as a voxel from where it was placed.
  memory.cornered = memory.cornered && (p - memory.other_anchor).norm() <= mode.voxel;
  if (memory.cornered) {
    room = add(set, PrimitiveKind::kPlane, memory.other_anchor, memory.other_normal, strength);
  }
  return add(set, PrimitiveKind::kPlane, memory.anchor, memory.normal, strength) && room;
}

}  // namespace

double Strength::operator()(const Properties& properties) const noexcept {
  if (scalar < 0) return curve(0.0);
  const Properties::Scalar& input = properties.scalars[static_cast<std::size_t>(scalar)];
  return input.inside ? curve(input.value) : 0.0;
}

bool addPrimitives(const Mode& mode, const Properties& properties, const Vec3& p,
                   ModeMemory& memory, PrimitiveSet& set) noexcept {
  const std::size_t before = set.size();
  const bool room =
      std::visit([&](const auto& m) { return emit(m, properties, p, memory, set); }, mode);
  memory.emitted = static_cast<int>(set.size() - before);
  return room;
}

void settle(const Mode& mode, const Vec3& proxy, ModeMemory& memory) noexcept {
  const auto* iso = std::get_if<IsosurfaceMode>(&mode);
  if (iso == nullptr || memory.contact == Contact::kInside) return;
  const double past = memory.normal.dot(memory.anchor - proxy);
  if (memory.contact == Contact::kOutside && memory.emitted > 0 && past > kYield * iso->voxel) {
    memory.contact = Contact::kYielded;
  }
}

}  // namespace palpate
