/// Numeric types of the engine. Lengths, times and forces are doubles in SI units, unless a comment
/// states another unit. The world frame W is right-handed and is the space of the user's hand.
#pragma once

#include <Eigen/Core>

/// Marks a function that a tick calls: no allocation, no lock, no system call. RealtimeSanitizer
/// can check this (clang 20 or newer, -fsanitize=realtime). The tests count allocations with every
/// compiler.
#if defined(__has_cpp_attribute)
#if __has_cpp_attribute(clang::nonblocking)
#define PALPATE_NONBLOCKING [[clang::nonblocking]]
#endif
#endif
#ifndef PALPATE_NONBLOCKING
#define PALPATE_NONBLOCKING
#endif

namespace palpate {

/// A position [m], displacement [m], force [N] or direction in W, unless its comment states another
/// unit or frame. Fixed size: never allocates.
using Vec3 = Eigen::Vector3d;
/// A 3x3 matrix, such as a rotation or a Jacobian. Column j of a Jacobian is the derivative by x_j.
using Mat3 = Eigen::Matrix3d;

/// Axis-aligned box [m], in W unless its comment states another frame. The box is empty if lower >
/// upper in some coordinate.
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
