/// Shared by the modes' own files: the place of a mode in a tick, and what each mode answers.
#pragma once

#include "palpate/engine/flow.h"
#include "palpate/engine/mode.h"
#include "palpate/engine/unit.h"

namespace palpate {

/// How a primitive that a mode adds varies with the place where properties were read; see Varying.
struct Variation {
  Mat3 turn = Mat3::Zero();    ///< Derivative of the direction [1/m].
  Vec3 slope = Vec3::Zero();   ///< Gradient of the strength [N/m]; zero for what is anchored at the
                               ///< proxy, which slips by the strength that was read.
  Vec3 across = Vec3::Zero();  ///< Varying::across of a plane that turns.
  double height = 0.0;         ///< Varying::height of a plane that turns [m].

  /// True if neither direction nor strength varies: `across` and `height` are then not told.
  [[nodiscard]] bool none() const noexcept { return turn.isZero(0.0) && slope.isZero(0.0); }
};

/// What the emit() functions below work with.
struct Place {
  const Properties& at;  ///< What was read last.
  const Stand& stand;    ///< Where the primitives belong.
  PrimitiveSet& set;     ///< Takes the primitives.

  /// The scalar property of index i, 0 to kMaxProperties - 1.
  [[nodiscard]] const Properties::Scalar& scalar(int i) const noexcept {
    return at.scalars[static_cast<std::size_t>(i)];
  }
  /// The vector property of index i, 0 to kMaxProperties - 1.
  [[nodiscard]] const Properties::Vector& vector(int i) const noexcept {
    return at.vectors[static_cast<std::size_t>(i)];
  }
  /// Adds a primitive; adds none where it has no strength. False where the set is full.
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

// Step 2 of the paper's figure 1, mode by mode: false where the set was full.
/// Places the plane at the proxy, or on V = Va while it holds; adds it, with friction a line, with
/// viscosity a point. RT: no allocation.
bool emit(const SurfaceMode& mode, const Place& place, SurfaceMemory& memory) noexcept;
/// Finds the side that the proxy is on; adds the plane on V = level where there is contact, with
/// friction a line, and in the solid the viscosity's point. RT: no allocation.
bool emit(const IsosurfaceMode& mode, const Place& place, IsosurfaceMemory& memory) noexcept;
/// Adds a line along the vector; none where that has no direction. RT: no allocation.
bool emit(const FollowMode& mode, const Place& place, FollowMemory& memory) noexcept;
/// Adds a plane across the vector, or two opposed; none where the vector has no direction, nor once
/// the front is let go. RT: no allocation.
bool emit(const FrontShapeMode& mode, const Place& place, FrontShapeMemory& memory) noexcept;
/// Adds a line along the core within two voxels of it, and two opposed planes across the radius
/// beyond one voxel; none where the flow does not turn. RT: no allocation.
bool emit(const VortexTubeMode& mode, const Place& place, VortexTubeMemory& memory) noexcept;

// Further answers that some modes give; see surfaceAhead and settle in mode.h.
/// V of the surface; null where it has none yet: it is through the proxy.
inline const double* levelOf(const IsosurfaceMode& mode, const IsosurfaceMemory& /*of*/) noexcept {
  return &mode.level;
}
/// Likewise: it has one once the surface has held the proxy.
inline const double* levelOf(const SurfaceMode& /*mode*/, const SurfaceMemory& memory) noexcept {
  return memory.captured ? &memory.level : nullptr;
}
/// None unless the proxy is outside and the surface did not yield in the last balance.
SurfaceAhead ahead(const IsosurfaceMode& mode, IsosurfaceMemory& memory) noexcept;
/// A surface that yielded, with the proxy over 0.05 voxel behind it, is pushed through; one that
/// bears nothing, with the proxy in front of it, is left.
void settle(const IsosurfaceMode& mode, const Vec3& proxy, bool arrived,
            IsosurfaceMemory& memory) noexcept;
/// A front that was let go may be placed anew, once the proxy has `arrived` at its balance.
void settle(const FrontShapeMode& mode, const Vec3& proxy, bool arrived,
            FrontShapeMemory& memory) noexcept;

}  // namespace palpate
