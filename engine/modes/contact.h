/// The contact of a proxy with a surface: its plane, the derivative of the normal, and the load.
#pragma once

#include <span>

#include "palpate/engine/balance/primitive.h"
#include "palpate/engine/field/placement.h"
#include "palpate/engine/field/properties.h"
#include "palpate/engine/types.h"

namespace palpate {

/// The surface of a scalar volume: the properties that it reads, its solid side and its scale.
struct SurfaceSource {
  int field = -1;                ///< Index into Graph::scalar_fields.
  int value = -1;                ///< Index into Properties::scalars.
  int gradient = -1;             ///< Index into Properties::vectors of the continuous gradient.
  int cell_gradient = -1;        ///< Index into Properties::vectors of the interpolated slope.
  double sign = -1.0;            ///< Outward normal = sign * gradient: -1 if high values are solid.
  double voxel = 1e-3;           ///< Shortest edge of a voxel [m].
  double metres_per_unit = 1.0;  ///< Metres per unit of the data's space.
  bool grooves = false;  ///< True if grooves increase the friction: for an isosurface with friction
                         ///< in a field that is a distance (FieldFrame::distance).
};

/// Corrections to the plane of a surface for other solids and other walls; see seams.h.
struct Seam {
  Vec3 gradient = Vec3::Zero();  ///< Term added to sign * gradient, in W [unit of the gradient].
  Mat3 turn = Mat3::Zero();      ///< Derivative of `gradient` [unit of the gradient / m].
  double walls = 1.0;  ///< Sum of the loads of a groove's walls, divided by the load of the plane.
};

/// The plane (eq. 13) on a surface V = Va. n is the direction of the continuous gradient, c that of
/// the interpolated value's slope at the reading. In a trilinear volume they differ.
struct Contact {
  Vec3 anchor = Vec3::Zero();   ///< A point of the plane [m].
  Vec3 normal = Vec3::UnitX();  ///< n, the outward unit normal.
  Mat3 turn = Mat3::Zero();     ///< dn/dx [1/m].
  Vec3 across = Vec3::UnitX();  ///< c, the outward unit normal of the interpolated surface.
  double height = 0.0;  ///< Height of the last reading above the surface, along c [m]. For a plane
                        ///< on V = Va, limited to half a voxel to either side.
  double walls = 1.0;   ///< Seam::walls of the last reading.
  bool placed = false;  ///< True if there is a plane.
  bool seen = false;    ///< True if the last reading put the plane on the surface.
  /// True if a sweep has reached the surface, where properties are read next.
  bool touched = false;
  int plane = -1;   ///< Index of the plane in the last balance; -1 if it was not in the balance.
  int varies = -1;  ///< Index of the plane in the last PrimitiveSet::varying().
  Load load = Load::kNone;  ///< Load of the plane in the last balance.
};

/// The surface V = Va, computed from one reading of properties.
struct SurfaceReading {
  bool data = false;  ///< True if there is a value.
  /// True if there is a normal, and the surface is within two voxels, as look() measures.
  bool clear = false;
  double height = 0.0;          ///< Height of the reading above the surface along n [voxels].
  Vec3 normal = Vec3::UnitX();  ///< n, the outward unit normal.
  Vec3 across = Vec3::UnitX();  ///< c, the outward unit normal of the interpolated surface.
  double off = 0.0;             ///< Height of the reading above the surface along c [voxels].
};
/// Computes the position of the surface V = level from a reading. `clear` requires that the surface
/// is within two voxels, by the steeper of the two slopes. The normal is that of the gradient plus
/// the correction of the seam, if any. RT: no allocation.
[[nodiscard]] SurfaceReading look(const SurfaceSource& skin, double level, const Properties& read,
                                  const Seam* seam = nullptr) noexcept PALPATE_NONBLOCKING;

/// Puts the plane on the surface, at most half a voxel from the place x [m] of the reading. If the
/// normal has reversed and no sweep reached the surface, the reading shows the other side of a thin
/// wall. The plane then stays if x is behind the surface; else the contact ends. RT: no allocation.
void place(Contact& contact, const SurfaceSource& skin, const SurfaceReading& sight,
           const Vec3& x) noexcept PALPATE_NONBLOCKING;
/// Moves the plane of a yielding surface to that surface, if it is within two voxels and its normal
/// within 60 deg of n. RT: no allocation.
void drag(Contact& contact, const SurfaceSource& skin, const SurfaceReading& sight,
          const Vec3& x) noexcept PALPATE_NONBLOCKING;
/// Ends the contact.
inline void leave(Contact& contact) noexcept {
  contact.placed = contact.touched = false;
}

/// Computes dn/dx of the plane that the last reading placed, where n is the normalised gradient.
/// `jacobian` is the derivative of the gradient [its unit / m], in W. RT: no allocation.
void readTurn(Contact& contact, const SurfaceSource& skin, const Properties& read,
              const Mat3& jacobian, const Seam* seam = nullptr) noexcept PALPATE_NONBLOCKING;
/// Writes how the plane varies about x [m], for Newton's step from there. If `foreseen`, uses the
/// remembered plane, because there was no reading at x. RT: no allocation.
void tellTurn(const Contact& contact, const SurfaceSource& skin, const Vec3& x, bool foreseen,
              Varying& plane) noexcept PALPATE_NONBLOCKING;

/// Adds the plane and, if `friction` > 0, a line (eq. 11) through p [m] along the normal, with zero
/// strength until the balance. If `strength` <= 0, adds no primitive. `slope` is the gradient of
/// the strength [N/m]. Returns false if the set was full. RT: no allocation.
[[nodiscard]] bool addContact(Contact& contact, double strength, const Vec3& slope, double friction,
                              const Vec3& p, PrimitiveSet& set) noexcept PALPATE_NONBLOCKING;

/// Sets the load of the contact from a balance. RT: no allocation.
void readLoad(Contact& contact, std::span<const Primitive> primitives,
              std::span<const Vec3> forces) noexcept PALPATE_NONBLOCKING;

/// Returns the offset to the free side [m] at which a sweep follows a path along the surface. `way`
/// is the length of the path [m]. The offset is a quarter of the path, at most a quarter of a
/// voxel; zero without a plane. For a path of at most a voxel between two points of a surface with
/// a radius of at least 5/8 of the path, the swept path is on the free side. RT: no allocation.
[[nodiscard]] Vec3 liftOff(const Contact& contact, double voxel,
                           double way) noexcept PALPATE_NONBLOCKING;

/// Moves the contact along with its volume. RT: no allocation.
void carry(const Pose& by, Contact& contact) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
