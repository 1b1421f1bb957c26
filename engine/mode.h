/// Haptic modes: from properties at the proxy to primitives (compiled form, indices only).
#pragma once

#include <cstdint>
#include <variant>

#include "engine/primitive.h"
#include "engine/properties.h"
#include "engine/transfer.h"
#include "engine/types.h"

namespace palpate {

/// How strong a mode's primitive is: a transfer function of one scalar property.
struct Strength {
  TransferFunction curve;
  int scalar = -1;  ///< Index into Properties::scalars; -1 where the curve is constant.

  /// Newtons, >= 0; 0 where the property has no data. RT: no allocation.
  [[nodiscard]] double operator()(const Properties& properties) const noexcept;
};

/// A directed force (eq. 8) along a vector: injects energy, as its user asked.
struct ForceMode {
  int vector = -1;    ///< Index into Properties::vectors.
  double sign = 1.0;  ///< +1 along it, -1 against it.
  Strength strength;
};

/// A point (eq. 9) at the proxy: a drag of constant size, not -b v.
struct ViscosityMode {
  int scalar = -1;  ///< Where this property has no data there is no drag.
  Strength strength;
};

/// A plane (eq. 13) at the proxy across the gradient: memoryless, so the proxy can drift along the
/// normal as the surface curves; isosurface does not drift.
struct SurfaceMode {
  int gradient = -1;
  double sign = -1.0;  ///< Outward normal = sign * gradient: -1 where high values are solid.
  Strength strength;
};

/// A plane (eq. 13) on the surface V = value near the proxy; remembers on which side it is. In a
/// concave edge both walls hold.
struct IsosurfaceMode {
  int value = -1;
  int gradient = -1;
  int cell_gradient = -1;
  double level = 0.0;            ///< V0, in the data's unit.
  double sign = -1.0;            ///< Outward normal = sign * gradient: -1 where high is solid.
  double voxel = 1e-3;           ///< [m]
  double metres_per_unit = 1.0;  ///< Of the field's own space.
  double depth = 3e-3;           ///< After yielding, pushes until this far past the surface [m].
  Strength strength;
};

/// A line (eq. 11) through the proxy along a vector: the hand slides along the stream.
struct FollowMode {
  int vector = -1;
  Strength strength;
};

using Mode = std::variant<ForceMode, ViscosityMode, SurfaceMode, IsosurfaceMode, FollowMode>;

/// What a mode remembers between ticks. All but `emitted` is isosurface's.
struct ModeMemory {
  enum class Contact : std::uint8_t {
    kUnknown,  ///< Nothing seen yet: takes the side it finds, without force.
    kOutside,  ///< On the free side: the surface holds.
    kYielded,  ///< Pushed through: the plane pulls back until `depth` or until the hand returns.
    kInside,   ///< On the solid side: free to move and to leave.
  };
  Contact contact = Contact::kUnknown;
  int emitted = 0;              ///< Primitives of this mode in the last sub-step.
  Vec3 anchor = Vec3::Zero();   ///< The plane's position [m].
  Vec3 normal = Vec3::UnitX();  ///< Its outward normal.
  bool placed = false;          ///< Outside, with the plane above placed.
  bool cornered = false;        ///< In a concave edge: the plane below is its other wall.
  Vec3 other_anchor = Vec3::Zero();
  Vec3 other_normal = Vec3::UnitX();
};

/// Step 2 of the paper's figure 1: adds the primitives that one mode asks for at the proxy.
///
/// @param p           The proxy before it moves [m]: primitives are anchored there.
/// @param properties  Sampled at p.
/// @return            False if the set was full and a primitive was dropped.
/// RT: no allocation.
[[nodiscard]] bool addPrimitives(const Mode& mode, const Properties& properties, const Vec3& p,
                                 ModeMemory& memory,
                                 PrimitiveSet& set) noexcept PALPATE_NONBLOCKING;

/// Tells a mode where the balance put the proxy, so that it can notice having been pushed through.
/// RT: no allocation.
void settle(const Mode& mode, const Vec3& proxy, ModeMemory& memory) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
