/// Textbook ways to move a proxy over a surface or along a stream. They keep the proxy's place and
/// nothing else: no value to come back to. For charts; the engine has its own (engine/step.h).
#pragma once

#include <memory>

#include "palpate/engine/field.h"
#include "palpate/engine/types.h"

namespace palpate::methods {

/// What one tick of a method did.
struct Moved {
  Vec3 proxy = Vec3::Zero();  ///< [m]
  int reads = 0;              ///< Of the field.
  int cells = 0;              ///< Looked at for a contact while nothing held the proxy.
  bool held = false;          ///< Something keeps the proxy from the hand.
};

/// How the hand's way of a tick is gone.
struct SurfaceRule {
  int substeps = 1;   ///< The way is cut into so many parts.
  int midpoints = 0;  ///< Times that the normal is read again, half-way to where the last one led.
                      ///< 1: the explicit midpoint rule; more: towards the implicit one.
};

/// A plane through the proxy, its normal read at the proxy: one balance in closed form a sub-step,
/// as in Lundin et al., section 3.2. A free proxy is caught where V falls through `level`; from
/// then on the level plays no part.
class MemorylessSurface {
 public:
  /// @param sign      +1 where the solid's values are below the level, -1 where they are above.
  /// @param give      Strength by stiffness, s/k: how far the hand can be from the proxy [m].
  MemorylessSurface(std::shared_ptr<const ScalarField> field, double level, double sign,
                    double give, const SurfaceRule& rule);

  /// The proxy begins at the first probe.
  [[nodiscard]] Moved tick(const Vec3& probe) noexcept;

 private:
  /// Where the spring and a plane through the proxy, its normal read at a place, balance. False
  /// where there is no normal.
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

/// How a line through the proxy is followed.
enum class Along {
  kTangent,   ///< Straight on: the line at the proxy.
  kMidpoint,  ///< By the direction half-way, the length that of the line's balance.
  kRk4,       ///< By Runge and Kutta's rule of order 4, the length likewise.
};

struct StreamRule {
  Along along = Along::kTangent;
  int substeps = 1;
};

/// A line through the proxy along v, in closed form: along it the proxy follows the hand, across it
/// the hand must pull by more than `give`. Rules of higher order go through the faces of cells as
/// if the field had no kinks there.
class MemorylessStream {
 public:
  /// @param give  s/k [m].
  MemorylessStream(std::shared_ptr<const VectorField> field, double give, const StreamRule& rule);

  [[nodiscard]] Moved tick(const Vec3& probe) noexcept;

 private:
  /// v / |v|; zero where there is none.
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
