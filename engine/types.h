/// Numeric types of the engine. All numbers are doubles in SI units. The world frame W is
/// right-handed and is the space of the user's hand.
#pragma once

#include <Eigen/Core>

/// Marks a function that a tick calls: no allocation, no lock, no system call. RealtimeSanitizer
/// checks this if the compiler has it (clang 20); otherwise the tests count allocations.
#if defined(__has_cpp_attribute)
#if __has_cpp_attribute(clang::nonblocking)
#define PALPATE_NONBLOCKING [[clang::nonblocking]]
#endif
#endif
#ifndef PALPATE_NONBLOCKING
#define PALPATE_NONBLOCKING
#endif

namespace palpate {

/// A position [m], displacement [m], force [N] or unit direction in W. Fixed size: never allocates.
using Vec3 = Eigen::Vector3d;
/// A rotation, or a Jacobian whose column j is the derivative by x_j.
using Mat3 = Eigen::Matrix3d;

/// Axis-aligned box in W [m]. The box is empty if lower > upper in some coordinate.
struct Box {
  Vec3 lower = Vec3::Constant(1.0);   ///< Least coordinates in the box [m].
  Vec3 upper = Vec3::Constant(-1.0);  ///< Greatest coordinates in the box [m].
  /// Returns true if the box contains no point.
  [[nodiscard]] bool empty() const noexcept { return (lower.array() > upper.array()).any(); }
  /// Extends the box so that it contains p [m].
  void extend(const Vec3& p) noexcept {
    const bool first = empty();
    lower = first ? p : Vec3(lower.cwiseMin(p));
    upper = first ? p : Vec3(upper.cwiseMax(p));
  }
  /// Returns the midpoint [m].
  [[nodiscard]] Vec3 centre() const noexcept { return 0.5 * (lower + upper); }
  /// Returns the lengths of the edges [m]. If the box is empty, some length is below 0.
  [[nodiscard]] Vec3 size() const noexcept { return upper - lower; }
};

}  // namespace palpate
