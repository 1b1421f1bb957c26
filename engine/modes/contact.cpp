#include "palpate/engine/modes/contact.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>

#include "palpate/engine/unit.h"

namespace palpate {
namespace {

/// Largest distance to the surface at which a reading places the plane [voxels].
constexpr double kSight = 2.0;
/// Largest distance from the place of a reading at which that reading puts the plane [voxels].
constexpr double kStep = 0.5;
/// If a reading is at most this far from the surface, the plane goes through the place of the
/// reading, so that kinks coincide [voxels].
constexpr double kOnIt = 1e-9;
/// Height above the surface at which a path along it is swept, divided by the length of the path. A
/// length above one voxel counts as one voxel.
constexpr double kLift = 0.25;

void put(Contact& contact, const SurfaceSource& skin, const SurfaceReading& sight,
         const Vec3& anchor) noexcept {
  contact.anchor = anchor;
  contact.normal = sight.normal;
  contact.across = sight.across;
  contact.height = std::clamp(sight.off, -kStep, kStep) * skin.voxel;
  contact.seen = true;
}

}  // namespace

SurfaceReading look(const SurfaceSource& skin, double level, const Properties& read,
                    const Seam* seam) noexcept {
  SurfaceReading sight;
  const Properties::Scalar& value = read.scalars[static_cast<std::size_t>(skin.value)];
  const Vec3& gradient = read.vectors[static_cast<std::size_t>(skin.gradient)].value;
  const Vec3& own = read.vectors[static_cast<std::size_t>(skin.cell_gradient)].value;
  sight.data = value.inside;
  Vec3 outwards = skin.sign * gradient;
  if (seam != nullptr) outwards += seam->gradient;
  if (!value.inside || !unit(outwards, sight.normal)) return sight;
  // `slope` is that of the interpolated V along the normal, or the gradient's norm if not positive.
  double slope = skin.sign * own.dot(sight.normal);
  if (!(slope > 0.0)) slope = gradient.norm();
  const double above = skin.sign * (value.value - level) * skin.metres_per_unit / skin.voxel;
  sight.height = above / slope;
  // The steeper slope decides whether the surface is near. Deep in a groove the cell's slope points
  // across the normal, so the height along the normal is not a distance.
  if (!unit(skin.sign * own, sight.across)) sight.across = sight.normal;
  sight.off = above / std::max(own.norm(), 1e-3 * gradient.norm());
  sight.clear = std::abs(above) <= kSight * std::max(own.norm(), gradient.norm());
  return sight;
}

void place(Contact& contact, const SurfaceSource& skin, const SurfaceReading& sight,
           const Vec3& x) noexcept {
  if (contact.placed && !contact.touched && sight.normal.dot(contact.normal) < 0.0) {
    // The reading shows the other side of a wall. If x is in front of that side, this contact ends.
    if (sight.height >= 0.0) leave(contact);
    return;
  }
  const double height = std::clamp(sight.height, -kStep, kStep);
  const bool on_it = std::abs(height) < kOnIt;
  put(contact, skin, sight, on_it ? x : Vec3(x - height * skin.voxel * sight.normal));
  contact.placed = true;
  contact.touched = false;
}

void drag(Contact& contact, const SurfaceSource& skin, const SurfaceReading& sight,
          const Vec3& x) noexcept {
  // Deep in a thin wall the normal reverses: the reading shows the other side of the wall.
  const bool near = sight.clear && std::abs(sight.height) <= kSight;
  if (!near || !(sight.normal.dot(contact.normal) > 0.5)) return;
  put(contact, skin, sight, x - sight.height * skin.voxel * sight.normal);
}

void readTurn(Contact& contact, const SurfaceSource& skin, const Properties& read,
              const Mat3& jacobian, const Seam* seam) noexcept {
  const Vec3& gradient = read.vectors[static_cast<std::size_t>(skin.gradient)].value;
  const Mat3 across = Mat3::Identity() - contact.normal * contact.normal.transpose();
  Vec3 outwards = skin.sign * gradient;
  Mat3 by_place = skin.sign * jacobian;
  if (seam != nullptr) {
    outwards += seam->gradient;
    by_place += seam->turn;
  }
  const Mat3 turned = across * by_place / outwards.norm();
  if (turned.allFinite()) contact.turn = turned;
}

void tellTurn(const Contact& contact, const SurfaceSource& skin, const Vec3& x, bool foreseen,
              Varying& plane) noexcept {
  plane.turn = contact.turn;
  // If no reading has put the plane on the surface, n replaces c.
  plane.across = contact.seen ? contact.across : contact.normal;
  const double over = plane.across.dot(contact.normal) * contact.normal.dot(x - contact.anchor);
  const double most = kStep * skin.voxel;
  plane.height = contact.seen && !foreseen ? contact.height : std::clamp(over, -most, most);
}

bool addContact(Contact& contact, double strength, const Vec3& slope, double friction,
                const Vec3& p, PrimitiveSet& set) noexcept {
  if (strength <= 0.0) return true;
  if (!set.tryAdd({PrimitiveKind::kPlane, contact.anchor, contact.normal, strength})) return false;
  contact.plane = static_cast<int>(set.size()) - 1;
  contact.varies = static_cast<int>(set.varying().size());
  Varying& plane = set.vary();
  plane.slope = slope;
  plane.surface = true;
  return friction <= 0.0 || set.tryAddFriction(p, friction);
}

void readLoad(Contact& contact, std::span<const Primitive> primitives,
              std::span<const Vec3> forces) noexcept {
  const auto i = static_cast<std::size_t>(contact.plane);
  const bool bears = contact.plane >= 0 && i < primitives.size();
  contact.load = bears ? loadOf(primitives[i], forces[i]) : Load::kNone;
}

Vec3 liftOff(const Contact& contact, double voxel, double way) noexcept {
  if (!contact.placed) return Vec3::Zero();
  return kLift * std::min(way, voxel) * contact.normal;
}

void carry(const Pose& by, Contact& contact) noexcept {
  contact.anchor = by(contact.anchor);
  (void)unit(by.gradient(contact.normal), contact.normal);
  contact.turn = by.gradientJacobian(contact.turn);
  (void)unit(by.gradient(contact.across), contact.across);
}

}  // namespace palpate
