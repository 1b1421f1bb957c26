/// The haptic primitives of Lundin et al., section 4.1: eqs (8), (9), (11), (13).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "palpate/engine/types.h"

namespace palpate {

/// The paper closes this list: directed force and constraints of three, two and one degrees of
/// freedom. A fifth kind should make every `switch` complain.
enum class PrimitiveKind : std::uint8_t {
  kForce,  ///< eq. (8): constant force along `direction`; `position` is ignored.
  kPoint,  ///< eq. (9): constant pull towards `position`; `direction` is ignored.
  kLine,   ///< eq. (11): constant pull towards the line through `position` along `direction`.
  kPlane,  ///< eq. (13): constant push along `direction`, only behind the plane (eq. 12).
};

/// The paper's word for it.
[[nodiscard]] const char* wordFor(PrimitiveKind kind) noexcept;

/// One primitive in W.
struct Primitive {
  PrimitiveKind kind = PrimitiveKind::kForce;
  Vec3 position = Vec3::Zero();    ///< x_i [m].
  Vec3 direction = Vec3::UnitX();  ///< q_i, unit length to 1e-6: |q|^2 within 2e-6 of 1.
  double strength = 0.0;           ///< s_i [N], >= 0.
};

/// How far x is from where the primitive is content: from its point or line, or behind its plane;
/// 0 for a force [m]. RT: no allocation.
[[nodiscard]] double distanceTo(const Primitive& primitive,
                                const Vec3& x) noexcept PALPATE_NONBLOCKING;

/// What a primitive does in a balance: nothing, it holds, or it gives way.
enum class Load : std::uint8_t {
  kNone,
  kHeld,      ///< 0 < load < strength: the balance is on it.
  kYielding,  ///< All its strength: the balance is where it could not hold it.
};
/// By what it does to the proxy [N]. RT: no allocation.
[[nodiscard]] inline Load loadOf(const Primitive& primitive, const Vec3& force) noexcept {
  constexpr double kLeast = 1e-12;  // [N]
  constexpr double kAll = 1.0 - 1e-9;
  const double load = force.norm();
  if (!(load > kLeast)) return Load::kNone;
  return load >= kAll * primitive.strength ? Load::kYielding : Load::kHeld;
}

/// How a primitive changes with the place x where properties were read: what Newton's step
/// (newton.h) knows of it beside the primitive itself.
struct Varying {
  std::size_t index = 0;       ///< Among the primitives.
  Mat3 turn = Mat3::Zero();    ///< Of a force's or a plane's direction n: dn/dx [1/m].
  Vec3 slope = Vec3::Zero();   ///< Of its strength: ds/dx [N/m].
  Vec3 across = Vec3::Zero();  ///< Of a plane: the place stays on it where across . step = -height.
                               ///< On a surface the slope c, unit, outwards, that the interpolated
                               ///< value has at x; where values are trilinear not n.
  double height = 0.0;         ///< So far along `across` is x above the plane [m].
  bool surface = false;        ///< It is the plane of a surface; of others false.
};

/// Most primitives that one tick may balance.
inline constexpr std::size_t kMaxPrimitives = 1024;

/// Coulomb friction: a line through the old proxy along a plane's normal, of the strength mu times
/// what that plane carries in the same balance. See friction.h.
struct FrictionLink {
  std::size_t plane = 0;     ///< Index of the plane in its set.
  std::size_t line = 0;      ///< And of the line.
  double coefficient = 0.0;  ///< mu, >= 0.
};

/// The primitives of one tick. Its memory is taken when it is made, none afterwards.
class PrimitiveSet {
 public:
  PrimitiveSet() : items_(kMaxPrimitives), links_(kMaxPrimitives), varying_(kMaxPrimitives) {}

  /// Appends one primitive; false, and nothing changed, when the set is full.
  /// RT: no allocation.
  [[nodiscard]] bool tryAdd(const Primitive& primitive) noexcept {
    if (count_ == items_.size()) return false;
    items_[count_++] = primitive;
    return true;
  }
  /// Appends the friction at `position` of the plane appended last; false also where that is none,
  /// or the coefficient is negative or no number. RT: no allocation.
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
  /// How the primitive appended last varies, to be written; asked again, the same. Of an empty set
  /// it is nobody's. RT: no allocation.
  Varying& vary() noexcept {
    if (count_ == 0) return varying_[0];
    if (varying_count_ == 0 || varying_[varying_count_ - 1].index + 1 != count_) {
      varying_[varying_count_] = {};
      varying_[varying_count_++].index = count_ - 1;
    }
    return varying_[varying_count_ - 1];
  }
  /// The strength of a friction's line [N]. RT: no allocation.
  void setStrength(const FrictionLink& link, double strength) noexcept {
    items_[link.line].strength = strength;
  }

  void clear() noexcept { count_ = link_count_ = varying_count_ = 0; }
  [[nodiscard]] std::size_t size() const noexcept { return count_; }
  [[nodiscard]] std::span<const Primitive> items() const noexcept {
    return {items_.data(), count_};
  }
  [[nodiscard]] std::span<const FrictionLink> links() const noexcept {
    return {links_.data(), link_count_};
  }
  /// Those that vary, in their order.
  [[nodiscard]] std::span<const Varying> varying() const noexcept {
    return {varying_.data(), varying_count_};
  }
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
