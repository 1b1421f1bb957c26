/// Private to the modes: the context of a mode in a tick, and the functions that each mode defines.
#pragma once

#include "palpate/engine/field/flow.h"
#include "palpate/engine/modes/mode.h"
#include "palpate/engine/unit.h"

namespace palpate {

/// Derivatives of a primitive by the place where properties were read; see Varying.
struct Variation {
  Mat3 turn = Mat3::Zero();  ///< Derivative of the direction [1/m].
  /// Gradient of the strength [N/m]; zero except for directed forces.
  Vec3 slope = Vec3::Zero();
  Vec3 across = Vec3::Zero();  ///< Varying::across of a plane that turns.
  double height = 0.0;         ///< Varying::height of a plane that turns [m].

  /// Returns true if neither direction nor strength varies.
  [[nodiscard]] bool none() const noexcept { return turn.isZero(0.0) && slope.isZero(0.0); }
};

/// Arguments of the emit() functions below.
struct EmitContext {
  const Properties& at;          ///< The last reading.
  const EvaluationPoint& stand;  ///< Places to which the primitives refer.
  PrimitiveSet& set;             ///< Set to which emit() adds primitives.

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

// Step 2 of the paper's figure 1. Each emit() adds the primitives of its mode and returns false if
// the set was full.
/// Places the plane at the proxy, or on V = Va while it holds the proxy. Adds the plane, a line if
/// there is friction, and a point if there is viscosity. RT: no allocation.
bool emit(const SurfaceMode& mode, const EmitContext& place, SurfaceMemory& memory) noexcept;
/// Finds the side of the proxy. In contact, adds the plane on V = level, and a line if there is
/// friction. In the solid, adds a point if there is viscosity. RT: no allocation.
bool emit(const IsosurfaceMode& mode, const EmitContext& place, IsosurfaceMemory& memory) noexcept;
/// Adds a line along the vector, if the vector has a direction. RT: no allocation.
bool emit(const FollowMode& mode, const EmitContext& place, FollowMemory& memory) noexcept;
/// Adds a plane perpendicular to the vector, or two opposed planes. Adds no plane if the vector has
/// no direction, or after the release of the proxy. RT: no allocation.
bool emit(const FrontShapeMode& mode, const EmitContext& place, FrontShapeMemory& memory) noexcept;
/// Adds a line along the core within two voxels of it, and two opposed planes perpendicular to the
/// radius beyond one voxel. Adds no primitive if the flow has no curl. RT: no allocation.
bool emit(const VortexTubeMode& mode, const EmitContext& place, VortexTubeMemory& memory) noexcept;

/// Returns a pointer to the value V on the surface.
inline const double* levelOf(const IsosurfaceMode& mode, const IsosurfaceMemory& /*of*/) noexcept {
  return &mode.level;
}
/// Returns a pointer to the value V on the surface; null until the surface has held the proxy.
inline const double* levelOf(const SurfaceMode& /*mode*/, const SurfaceMemory& memory) noexcept {
  return memory.captured ? &memory.level : nullptr;
}
/// Returns the surface if the proxy is outside and the surface did not yield; else null pointers.
SurfaceAhead ahead(const IsosurfaceMode& mode, IsosurfaceMemory& memory) noexcept;
/// Marks a surface as pushed through if it yielded and the proxy is more than 0.05 voxel behind it.
/// Ends the contact if the surface bears no load and the proxy is more than 1e-4 voxel in front of
/// it.
void settle(const IsosurfaceMode& mode, const Vec3& proxy, bool arrived,
            IsosurfaceMemory& memory) noexcept;
/// Allows a released front to be placed again, once the proxy has `arrived` at its balance.
void settle(const FrontShapeMode& mode, const Vec3& proxy, bool arrived,
            FrontShapeMemory& memory) noexcept;

}  // namespace palpate
