/// The contact of a proxy with a surface: one plane, how it turns, and the load that it bears.
#pragma once

#include <span>

#include "palpate/engine/placement.h"
#include "palpate/engine/primitive.h"
#include "palpate/engine/properties.h"
#include "palpate/engine/types.h"

namespace palpate {

/// The surface of a scalar volume: which properties it reads, its solid side and its scale.
struct Skin {
  int field = -1;                ///< Index into Graph::scalar_fields.
  int value = -1;                ///< Index into Properties::scalars.
  int gradient = -1;             ///< Index into Properties::vectors: continuous gradient.
  int cell_gradient = -1;        ///< Index into Properties::vectors: slope as interpolated.
  double sign = -1.0;            ///< Outward normal = sign * gradient: -1 where high is solid.
  double voxel = 1e-3;           ///< Shortest edge of a voxel [m].
  double metres_per_unit = 1.0;  ///< Metres per unit of the field's own space.
};

/// The plane (eq. 13) on a surface V = Va. Its normal n is that of the continuous gradient, c that
/// of the interpolated value's slope where V was read; in a trilinear volume these differ.
struct Contact {
  Vec3 anchor = Vec3::Zero();   ///< A point of the plane [m].
  Vec3 normal = Vec3::UnitX();  ///< n, unit, outwards.
  Mat3 turn = Mat3::Zero();     ///< dn/dx [1/m].
  Vec3 across = Vec3::UnitX();  ///< c, unit, outwards: normal to the interpolated surface.
  double height = 0.0;          ///< Height along c of the last reading above the surface [m].
  bool placed = false;          ///< There is a plane.
  bool seen = false;            ///< The last reading put the plane on the surface.
  bool touched = false;         ///< A sweep reached the surface where properties are read next.
  int plane = -1;               ///< Index of the plane in the last balance; -1: none.
  int varies = -1;              ///< Index of the plane in the last PrimitiveSet::varying().
  Load load = Load::kNone;      ///< Load of the plane in the last balance.
};

/// The surface V = Va, seen from where properties were read.
struct Sight {
  bool data = false;            ///< There is a value.
  bool clear = false;           ///< There is a normal, and the surface is near enough to place.
  double height = 0.0;          ///< Height above the surface along n [voxels].
  Vec3 normal = Vec3::UnitX();  ///< n, unit, outwards.
  Vec3 across = Vec3::UnitX();  ///< c, unit, outwards.
  double off = 0.0;             ///< Height above the surface along c [voxels].
};
/// Looks for V = level: near within two voxels, by the steeper of two slopes. RT: no allocation.
[[nodiscard]] Sight look(const Skin& skin, double level,
                         const Properties& read) noexcept PALPATE_NONBLOCKING;

/// Puts the plane on the surface, at most half a voxel from x [m], where properties were read. A
/// normal that has turned over without a sweep reaching the surface is the other side of a thin
/// wall: behind the surface the plane stays, in front of it the contact ends. RT: no allocation.
void place(Contact& contact, const Skin& skin, const Sight& sight,
           const Vec3& x) noexcept PALPATE_NONBLOCKING;
/// Puts the plane of a yielding surface on it at once, within two voxels and 60 deg of the last n.
void drag(Contact& contact, const Skin& skin, const Sight& sight,
          const Vec3& x) noexcept PALPATE_NONBLOCKING;
/// Ends the contact.
inline void leave(Contact& contact) noexcept {
  contact.placed = contact.touched = false;
}

/// Reads how the plane turns that the last reading placed: dn/dx, n the normalised gradient.
///
/// @param jacobian  Derivative of the gradient [its unit / m], in W. RT: no allocation.
void readTurn(Contact& contact, const Skin& skin, const Properties& read,
              const Mat3& jacobian) noexcept PALPATE_NONBLOCKING;
/// Tells how the plane varies about x [m], for Newton's step from there. `foreseen`: nothing was
/// read at x, and the plane is where it is remembered. RT: no allocation.
void tellTurn(const Contact& contact, const Skin& skin, const Vec3& x, bool foreseen,
              Varying& plane) noexcept PALPATE_NONBLOCKING;

/// Adds the plane and, with friction, a line (eq. 11) through p [m] along its normal. Without load
/// the line has no strength, so that the set of a contact stays the same from tick to tick. False
/// if the set was full. RT: no allocation.
///
/// @param slope  Gradient of the strength [N/m].
[[nodiscard]] bool addContact(Contact& contact, double strength, const Vec3& slope, double friction,
                              const Vec3& p, PrimitiveSet& set) noexcept PALPATE_NONBLOCKING;

/// Reads off a balance what the plane bears. RT: no allocation.
void readLoad(Contact& contact, std::span<const Primitive> primitives,
              std::span<const Vec3> forces) noexcept PALPATE_NONBLOCKING;

/// The offset of a sweep from a path of this length [m] along the surface, to the free side: a
/// quarter of the path, of a voxel at most. It clears the chord of a surface whose radius of
/// curvature is 5/8 of the path or more. Zero where there is no plane. RT: no allocation.
[[nodiscard]] Vec3 liftOff(const Contact& contact, double voxel,
                           double way) noexcept PALPATE_NONBLOCKING;

/// Moves the contact along with its volume. RT: no allocation.
void carry(const Pose& by, Contact& contact) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
