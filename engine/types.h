/// Numbers of the engine: SI units, right-handed world W (the user's hand space), doubles.
#pragma once

#include <Eigen/Core>

/// Marks a function of the tick: no allocation, no lock, no system call. RealtimeSanitizer checks
/// it where the compiler has one (clang 20); elsewhere the tests count allocations.
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
using Mat3 = Eigen::Matrix3d;  ///< A rotation, or a Jacobian: column j is the change by x_j.

/// Axis-aligned box in W [m]. Empty while lower > upper.
struct Box {
  Vec3 lower = Vec3::Constant(1.0);   ///< Least coordinates in the box [m].
  Vec3 upper = Vec3::Constant(-1.0);  ///< Greatest coordinates in the box [m].
  /// True if the box holds no point: lower > upper in some coordinate.
  [[nodiscard]] bool empty() const noexcept { return (lower.array() > upper.array()).any(); }
  /// Grows the box to hold p [m] as well.
  void extend(const Vec3& p) noexcept {
    const bool first = empty();
    lower = first ? p : Vec3(lower.cwiseMin(p));
    upper = first ? p : Vec3(upper.cwiseMax(p));
  }
  [[nodiscard]] Vec3 centre() const noexcept { return 0.5 * (lower + upper); }  ///< Midpoint [m].
  [[nodiscard]] Vec3 size() const noexcept { return upper - lower; }  ///< Edges [m]; < 0 if empty.
};

}  // namespace palpate
