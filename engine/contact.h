/// A surface where a proxy meets it: one plane, how that turns, and what it bears.
#pragma once

#include <span>

#include "palpate/engine/placement.h"
#include "palpate/engine/primitive.h"
#include "palpate/engine/properties.h"
#include "palpate/engine/types.h"

namespace palpate {

/// What a surface reads of its scalar volume.
struct Skin {
  int field = -1;  ///< Index into Graph::scalar_fields.
  int value = -1;  ///< -> Properties::scalars
  int gradient = -1;
  int cell_gradient = -1;        ///< The slope that the value really has.
  double sign = -1.0;            ///< Outward normal = sign * gradient: -1 where high is solid.
  double voxel = 1e-3;           ///< [m]
  double metres_per_unit = 1.0;  ///< Of the field's own space.
};

/// The plane (eq. 13) on a surface V = Va: n by the continuous gradient, c by the slope that the
/// interpolated value has where it was read. In a trilinear volume these differ.
struct Contact {
  Vec3 anchor = Vec3::Zero();   ///< On the plane [m].
  Vec3 normal = Vec3::UnitX();  ///< n, unit, outwards.
  Mat3 turn = Mat3::Zero();     ///< dn/dx [1/m].
  Vec3 across = Vec3::UnitX();  ///< c, unit, outwards: the surface is across it,
  double height = 0.0;          ///< and where was read so far above along it [m].
  bool placed = false;          ///< There is a plane,
  bool seen = false;            ///< put on the surface by the last reading.
  bool touched = false;         ///< A sweep met the surface where properties are read next.
  int plane = -1;               ///< The primitive of the last balance that it is; -1: none,
  int varies = -1;              ///< and which of those that vary,
  Load load = Load::kNone;      ///< and what that did there.
};

/// Where V = Va is, seen from where properties were read.
struct Sight {
  bool data = false;            ///< There is a value,
  bool clear = false;           ///< a normal, and the surface is near enough to be placed.
  double height = 0.0;          ///< Along n above the surface [voxels].
  Vec3 normal = Vec3::UnitX();  ///< n
  Vec3 across = Vec3::UnitX();  ///< c,
  double off = 0.0;             ///< and the height along that [voxels].
};
/// It is near within two voxels, by the steeper of the two slopes. RT: no allocation.
[[nodiscard]] Sight look(const Skin& skin, double level,
                         const Properties& read) noexcept PALPATE_NONBLOCKING;

/// Puts the plane on the surface, at most half a voxel from x, where properties were read. One that
/// has turned over without having been met is the other side of a thin wall: behind the surface the
/// plane stays, before it the contact is over. RT: no allocation.
void place(Contact& contact, const Skin& skin, const Sight& sight,
           const Vec3& x) noexcept PALPATE_NONBLOCKING;
/// The same, for a surface that yields: however far it is, and whether or not it was met.
void drag(Contact& contact, const Skin& skin, const Sight& sight,
          const Vec3& x) noexcept PALPATE_NONBLOCKING;
/// The contact is over.
inline void leave(Contact& contact) noexcept {
  contact.placed = contact.touched = false;
}

/// How the plane turns that the last reading placed: dn/dx of its normalised gradient.
///
/// @param jacobian  Of the gradient [its unit / m], in W. RT: no allocation.
void readTurn(Contact& contact, const Skin& skin, const Properties& read,
              const Mat3& jacobian) noexcept PALPATE_NONBLOCKING;
/// How the plane varies about x [m], for Newton's step from there. `foreseen`: nothing was read
/// there, the plane is where it is remembered. RT: no allocation.
void tellTurn(const Contact& contact, const Skin& skin, const Vec3& x, bool foreseen,
              Varying& plane) noexcept PALPATE_NONBLOCKING;

/// Adds the plane and, with friction, its line (eq. 11) through p; without load that is a line of
/// no strength, so that the set of a contact stays the same from tick to tick. False if the set was
/// full. RT: no allocation.
///
/// @param slope  Of the strength [N/m].
[[nodiscard]] bool addContact(Contact& contact, double strength, const Vec3& slope, double friction,
                              const Vec3& p, PrimitiveSet& set) noexcept PALPATE_NONBLOCKING;

/// Reads off a balance what the plane bears. RT: no allocation.
void readLoad(Contact& contact, std::span<const Primitive> primitives,
              std::span<const Vec3> forces) noexcept PALPATE_NONBLOCKING;

/// Off the surface by a fraction of a way so long [m], on the free side: whence that is swept. The
/// chord of a surface that bends by a radius of 5/8 of the way or more is free so. Zero where
/// there is no plane. RT: no allocation.
[[nodiscard]] Vec3 liftOff(const Contact& contact, double voxel,
                           double way) noexcept PALPATE_NONBLOCKING;

/// Moves it along with its volume. RT: no allocation.
void carry(const Pose& by, Contact& contact) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
