/// Textbook methods that move a proxy over a surface or along a stream. They keep the proxy's
/// place, but no level or line. For charts; the engine's method is in engine/tick/step.h.
#pragma once

#include <memory>

#include "palpate/engine/field/field.h"
#include "palpate/engine/types.h"

namespace palpate::methods {

struct Moved {
  Vec3 proxy = Vec3::Zero();  ///< Position of the proxy in W [m].
  int reads = 0;              ///< Number of readings of the field.
  int cells = 0;              ///< Number of cells searched for a contact while the proxy was free.
  bool held = false;          ///< True if the method has a plane or a line that holds the proxy.
};

/// Setting of a surface method: how it divides the hand's path in one tick.
struct SurfaceRule {
  int substeps = 1;  ///< Number of parts of the hand's path.
  /// Number of repetitions of a sub-step, each with the normal half-way to the end of the previous
  /// try. 0: no repetition. 1: the explicit midpoint rule. Larger numbers approach the implicit
  /// midpoint rule.
  int midpoints = 0;
};

/// A plane through the proxy, with the normal read there. Each sub-step has a balance in closed
/// form (Lundin et al., section 3.2), and one more for each of SurfaceRule::midpoints. A free proxy
/// touches the surface where the field's value crosses `level` on the way into the solid. During
/// the contact the level has no effect.
class MemorylessSurface {
 public:
  /// @param sign  +1 if the solid's values are below the level, -1 if they are above.
  /// @param give  Strength / stiffness, s/k: the largest distance from hand to proxy [m].
  MemorylessSurface(std::shared_ptr<const ScalarField> field, double level, double sign,
                    double give, const SurfaceRule& rule);

  /// Moves the proxy by one tick. In the first call, the proxy starts at the probe.
  [[nodiscard]] Moved tick(const Vec3& probe) noexcept;

 private:
  /// Balances the spring with a plane through the proxy and the normal at `at`. Returns false if
  /// `at` is outside the data, if the normal is zero, or if the probe is in front of the plane.
  bool balance(const Vec3& at, const Vec3& probe, Vec3& end, Moved& moved) noexcept;
  void move(const Vec3& probe, Moved& moved) noexcept;

  std::shared_ptr<const ScalarField> field_;
  std::unique_ptr<FieldCache> cache_;
  double level_;
  double sign_;
  double give_;
  SurfaceRule rule_;
  bool placed_ = false;
  bool free_ = true;
  Vec3 proxy_ = Vec3::Zero();
  Vec3 probe_ = Vec3::Zero();
};

enum class Along {
  kTangent,  ///< Straight along the line at the proxy.
  /// Along the direction at the half-way point, by the length of the line's balance, but at most
  /// four voxels.
  kMidpoint,
  kRk4,  ///< Runge-Kutta rule of order 4, by the same length as kMidpoint.
};

struct StreamRule {
  Along along = Along::kTangent;
  int substeps = 1;
};

/// A line through the proxy along the flow, in closed form. The proxy follows the hand along the
/// line. Perpendicular to the line, it moves only if the hand is farther away than `give`. Rules of
/// higher order ignore the field's kinks at the faces of cells.
class MemorylessStream {
 public:
  /// @param give  Strength / stiffness, s/k [m].
  MemorylessStream(std::shared_ptr<const VectorField> field, double give, const StreamRule& rule);

  [[nodiscard]] Moved tick(const Vec3& probe) noexcept;

 private:
  /// Returns the unit direction of the flow, or zero if the flow is zero or `at` is outside the
  /// data.
  [[nodiscard]] Vec3 direction(const Vec3& at, Moved& moved) noexcept;
  void move(const Vec3& probe, Moved& moved) noexcept;

  std::shared_ptr<const VectorField> field_;
  std::unique_ptr<FieldCache> cache_;
  double give_;
  StreamRule rule_;
  bool placed_ = false;
  Vec3 proxy_ = Vec3::Zero();
  Vec3 probe_ = Vec3::Zero();
};

}  // namespace palpate::methods
