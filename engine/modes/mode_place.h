/// Shared by the modes' own files: the context of a mode in a tick, and the functions that each
/// mode defines.
#pragma once

#include "palpate/engine/field/flow.h"
#include "palpate/engine/modes/mode.h"
#include "palpate/engine/unit.h"

namespace palpate {

/// Derivatives of a primitive that a mode adds, by the place where properties were read; see
/// Varying.
struct Variation {
  Mat3 turn = Mat3::Zero();    ///< Derivative of the direction [1/m].
  Vec3 slope = Vec3::Zero();   ///< Gradient of the strength [N/m]; zero for primitives anchored at
                               ///< the proxy, which slip by the strength that was read.
  Vec3 across = Vec3::Zero();  ///< Varying::across of a plane that turns.
  double height = 0.0;         ///< Varying::height of a plane that turns [m].

  /// Returns true if neither direction nor strength varies: `across` and `height` are then not
  /// passed on.
  [[nodiscard]] bool none() const noexcept { return turn.isZero(0.0) && slope.isZero(0.0); }
};

/// Context of the emit() functions below.
struct EmitContext {
  const Properties& at;          ///< The last reading.
  const EvaluationPoint& stand;  ///< Places that the primitives refer to.
  PrimitiveSet& set;             ///< Receives the primitives.

  /// Returns the scalar property of index i, 0 to kMaxProperties - 1.
  [[nodiscard]] const Properties::Scalar& scalar(int i) const noexcept {
    return at.scalars[static_cast<std::size_t>(i)];
  }
  /// Returns the vector property of index i, 0 to kMaxProperties - 1.
  [[nodiscard]] const Properties::Vector& vector(int i) const noexcept {
    return at.vectors[static_cast<std::size_t>(i)];
  }
  /// Adds a primitive if its strength is above 0. Returns false if the set is full.
  bool add(PrimitiveKind kind, const Vec3& position, const Vec3& direction, double strength,
           const Variation& variation = {}) const noexcept {
    if (strength <= 0.0) return true;
    if (!set.tryAdd({kind, position, direction, strength})) return false;
    if (variation.none()) return true;
    Varying& varying = set.vary();
    varying.turn = variation.turn;
    varying.slope = variation.slope;
    varying.across = variation.across;
    varying.height = variation.height;
    return true;
  }
  /// Adds a primitive at the proxy.
  bool add(PrimitiveKind kind, const Vec3& direction, double strength,
           const Variation& variation = {}) const noexcept {
    return add(kind, stand.proxy, direction, strength, variation);
  }
};

// Step 2 of the paper's figure 1, mode by mode. Each function returns false if the set was full.
/// Places the plane at the proxy, or on V = Va while it holds. Adds it, with friction also a line,
/// with viscosity also a point. RT: no allocation.
bool emit(const SurfaceMode& mode, const EmitContext& place, SurfaceMemory& memory) noexcept;
/// Finds the side that the proxy is on. In contact, adds the plane on V = level, with friction also
/// a line. In the solid, adds the viscosity's point. RT: no allocation.
bool emit(const IsosurfaceMode& mode, const EmitContext& place, IsosurfaceMemory& memory) noexcept;
/// Adds a line along the vector, if the vector has a direction. RT: no allocation.
bool emit(const FollowMode& mode, const EmitContext& place, FollowMemory& memory) noexcept;
/// Adds a plane across the vector, or two opposed ones. Adds no plane if the vector has no
/// direction, or once the front is let go. RT: no allocation.
bool emit(const FrontShapeMode& mode, const EmitContext& place, FrontShapeMemory& memory) noexcept;
/// Adds a line along the core within two voxels of it, and two opposed planes across the radius
/// beyond one voxel. Adds no primitive if the flow does not turn. RT: no allocation.
bool emit(const VortexTubeMode& mode, const EmitContext& place, VortexTubeMemory& memory) noexcept;

// Further functions that some modes define; see surfaceAhead and settle in mode.h.
/// Returns V of the surface.
inline const double* levelOf(const IsosurfaceMode& mode, const IsosurfaceMemory& /*of*/) noexcept {
  return &mode.level;
}
/// Returns V of the surface; null until the surface has held the proxy, since it goes through the
/// proxy.
inline const double* levelOf(const SurfaceMode& /*mode*/, const SurfaceMemory& memory) noexcept {
  return memory.captured ? &memory.level : nullptr;
}
/// Returns the surface if the proxy is outside and the surface did not yield in the last balance;
/// else an empty one.
SurfaceAhead ahead(const IsosurfaceMode& mode, IsosurfaceMemory& memory) noexcept;
/// Marks a surface as pushed through if it yielded and the proxy is over 0.05 voxel behind it. Ends
/// the contact if the surface bears no load and the proxy is in front of it.
void settle(const IsosurfaceMode& mode, const Vec3& proxy, bool arrived,
            IsosurfaceMemory& memory) noexcept;
/// Allows a front that was let go to be placed again, once the proxy has `arrived` at its balance.
void settle(const FrontShapeMode& mode, const Vec3& proxy, bool arrived,
            FrontShapeMemory& memory) noexcept;

}  // namespace palpate
