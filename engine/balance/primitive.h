/// The haptic primitives of Lundin et al., section 4.1: eqs (8), (9), (11), (13).
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate {

/// Kind of a primitive, as in the paper. Do not add a default to a `switch` over this enum, so that
/// the compiler warns about a missing kind.
enum class PrimitiveKind : std::uint8_t {
  kForce,  ///< eq. (8): force s_i along `direction`; `position` is ignored.
  kPoint,  ///< eq. (9): pull of s_i towards `position`; `direction` is ignored.
  kLine,   ///< eq. (11): pull of s_i towards the line through `position` along `direction`.
  kPlane,  ///< eq. (13): push of s_i along `direction` behind the plane (eq. 12), else zero.
};

/// Returns "force", "point", "line" or "plane"; an empty string for other values.
[[nodiscard]] const char* wordFor(PrimitiveKind kind) noexcept;

/// One primitive in W.
struct Primitive {
  PrimitiveKind kind = PrimitiveKind::kForce;  ///< Determines the equation of the force.
  Vec3 position = Vec3::Zero();                ///< Anchor x_i [m].
  Vec3 direction = Vec3::UnitX();  ///< Direction q_i, of unit length: |q_i|^2 is within 2e-6 of 1.
  double strength = 0.0;           ///< Strength s_i [N], >= 0.
};

/// Returns true if a balance accepts the primitive: its kind exists, its strength is finite and >=
/// 0, its position is finite and its direction has unit length. Does not check members that its
/// kind ignores. RT: no allocation.
[[nodiscard]] inline bool isValid(const Primitive& primitive) noexcept {
  if (primitive.kind > PrimitiveKind::kPlane) return false;
  if (!(primitive.strength >= 0.0) || !std::isfinite(primitive.strength)) return false;
  if (primitive.kind != PrimitiveKind::kForce && !primitive.position.allFinite()) return false;
  if (primitive.kind == PrimitiveKind::kPoint) return true;
  return std::abs(primitive.direction.squaredNorm() - 1.0) <= 2e-6;  // false for NaN too
}

/// Returns the distance [m] of x from the point or line, or its depth behind the plane. Returns 0
/// for a directed force. RT: no allocation.
[[nodiscard]] double distanceTo(const Primitive& primitive,
                                const Vec3& x) noexcept PALPATE_NONBLOCKING;

/// State of a primitive in a balance.
enum class Load : std::uint8_t {
  kNone,      ///< The load is at most 1e-12 N, or NaN.
  kHeld,      ///< The load is between kNone and kYielding: the balance is on the primitive.
  kYielding,  ///< The load is at least (1 - 1e-9) strength: the primitive cannot hold the proxy.
};
/// Returns the state of a primitive, given its force on the proxy [N]. RT: no allocation.
[[nodiscard]] inline Load loadOf(const Primitive& primitive, const Vec3& force) noexcept {
  constexpr double kLeast = 1e-12;  // [N]
  constexpr double kAll = 1.0 - 1e-9;
  const double load = force.norm();
  if (!(load > kLeast)) return Load::kNone;
  return load >= kAll * primitive.strength ? Load::kYielding : Load::kHeld;
}

/// Derivatives of a primitive by the place x of the reading, for Newton's step (newton.h).
struct Varying {
  std::size_t index = 0;      ///< Index of the primitive that varies.
  Mat3 turn = Mat3::Zero();   ///< dn/dx [1/m], where n is the direction of a force or a plane.
  Vec3 slope = Vec3::Zero();  ///< ds/dx [N/m], where s is the strength.
  /// For a plane: a step from x ends on the plane if across . step = -height. If `across` is zero,
  /// newtonStep() uses n. For a surface: c, the outward unit vector along the slope of the
  /// interpolated value at x. In trilinear data c differs from n.
  Vec3 across = Vec3::Zero();
  double height = 0.0;   ///< Height of x above the plane, along `across` [m].
  bool surface = false;  ///< True for the plane of a surface.
};

/// Largest number of primitives in the balance of one tick.
inline constexpr std::size_t kMaxPrimitives = 1024;

/// Coulomb friction: a line through the old proxy along a plane's normal. Its strength is mu times
/// the load of the plane in the same balance (friction.h).
struct FrictionLink {
  std::size_t plane = 0;     ///< Index of the plane in its set.
  std::size_t line = 0;      ///< Index of the friction's line in the same set.
  double coefficient = 0.0;  ///< Coefficient mu, >= 0.
};

/// The primitives of one balance. The constructor allocates all memory.
class PrimitiveSet {
 public:
  PrimitiveSet() : items_(kMaxPrimitives), links_(kMaxPrimitives), varying_(kMaxPrimitives) {}

  /// Appends a primitive. Returns false and changes no state if the set is full. RT: no allocation.
  [[nodiscard]] bool tryAdd(const Primitive& primitive) noexcept {
    if (count_ == items_.size()) return false;
    items_[count_++] = primitive;
    return true;
  }
  /// Appends friction at `position` [m] to the last primitive. Returns false if the set is full or
  /// empty, if its last primitive is not a plane, or if the coefficient is not within 0 to 1e9. RT:
  /// no allocation.
  [[nodiscard]] bool tryAddFriction(const Vec3& position, double coefficient) noexcept {
    const std::size_t plane = count_ - 1;
    if (count_ == 0 || items_[plane].kind != PrimitiveKind::kPlane || !(coefficient >= 0.0) ||
        !(coefficient <= 1e9)) {
      return false;
    }
    if (!tryAdd({PrimitiveKind::kLine, position, items_[plane].direction, 0.0})) return false;
    links_[link_count_++] = {plane, plane + 1, coefficient};
    return true;
  }
  /// Returns the Varying entry of the last primitive, for writing. A second call returns the same
  /// entry. If the set is empty, the entry belongs to no primitive. RT: no allocation.
  Varying& vary() noexcept {
    if (count_ == 0) return varying_[0];
    if (varying_count_ == 0 || varying_[varying_count_ - 1].index + 1 != count_) {
      varying_[varying_count_] = {};
      varying_[varying_count_++].index = count_ - 1;
    }
    return varying_[varying_count_ - 1];
  }
  /// Sets the strength of a friction's line [N]. RT: no allocation.
  void setStrength(const FrictionLink& link, double strength) noexcept {
    items_[link.line].strength = strength;
  }

  /// Moves primitive i to `position` [m]. RT: no allocation.
  void setPosition(std::size_t i, const Vec3& position) noexcept { items_[i].position = position; }

  /// Removes all primitives, links and Varying entries; keeps the memory. RT: no allocation.
  void clear() noexcept { count_ = link_count_ = varying_count_ = 0; }
  /// Returns the number of primitives, friction lines included.
  [[nodiscard]] std::size_t size() const noexcept { return count_; }
  /// Returns the primitives in the order of adding, friction lines included.
  [[nodiscard]] std::span<const Primitive> items() const noexcept {
    return {items_.data(), count_};
  }
  /// Returns the friction links in the order of adding. Their indices refer to items().
  [[nodiscard]] std::span<const FrictionLink> links() const noexcept {
    return {links_.data(), link_count_};
  }
  /// Returns the Varying entries, in the order of their primitives.
  [[nodiscard]] std::span<const Varying> varying() const noexcept {
    return {varying_.data(), varying_count_};
  }
  /// Returns the Varying entries, for writing.
  [[nodiscard]] std::span<Varying> varying() noexcept { return {varying_.data(), varying_count_}; }

 private:
  std::vector<Primitive> items_;
  std::vector<FrictionLink> links_;
  std::vector<Varying> varying_;
  std::size_t count_ = 0;
  std::size_t link_count_ = 0;
  std::size_t varying_count_ = 0;
};

}  // namespace palpate
