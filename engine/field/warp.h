/// Deformation of a volume: displacements from material points to their resting positions.
#pragma once

#include <array>
#include <cmath>
#include <limits>
#include <memory>

#include "palpate/engine/types.h"

namespace palpate {

/// The value of a displacement field at one place and time.
struct Displacement {
  Vec3 shift = Vec3::Zero();  ///< Displacement u [m].
  Mat3 slope = Mat3::Zero();  ///< slope(i, j) = d u_i / d x_j
  Vec3 rate = Vec3::Zero();   ///< du/dt at a fixed x [m/s]
  /// bend[i](j, k) = d^2 u_i / dx_j dx_k [1/m]: the curvature that u adds to surfaces. If a warp
  /// leaves it zero, ticks take more readings.
  std::array<Mat3, 3> bend{Mat3::Zero(), Mat3::Zero(), Mat3::Zero()};
};

/// A displacement field. The material at x at time t rests at X = x + u(x, t), both in the volume's
/// resting frame [m]. As in image registration, u points back to the resting place. A reading of
/// the volume at x gives the value at X. With F = dX/dx = I + du/dx, a gradient g at X becomes F^T
/// g at x, and a material vector v becomes F^-1 v. The material at x moves at -F^-1 du/dt.
/// (Fortmeier, Wilms, Mastmeyer, Handels, ToH 2015.) Const and shared between threads.
class Warp {
 public:
  Warp() = default;
  Warp(const Warp&) = delete;
  Warp& operator=(const Warp&) = delete;
  virtual ~Warp() = default;

  /// Returns the displacement at x [m] and `time` [s]. The displacement must be finite for finite
  /// input, and continuous. Its slope must be continuous except at the rim of a bounded region. RT:
  /// no allocation, no lock. Cost: one reading of a vector.
  [[nodiscard]] virtual Displacement at(const Vec3& x,
                                        double time) const noexcept PALPATE_NONBLOCKING = 0;
  /// Returns a box that contains x - X for every place and time [m].
  [[nodiscard]] virtual Box shifts() const = 0;
  /// Returns the largest speed of the material [m/s]. It may come from samples, so the speed
  /// between them can be higher.
  [[nodiscard]] virtual double topSpeed() const = 0;
  /// Returns an upper bound of |d^2 u / dt^2| at a fixed x [m/s^2]. This bound limits how far the
  /// rate can predict u. With the default, infinity, u is not predicted, so a tick takes more
  /// readings of the warp.
  [[nodiscard]] virtual double topAcceleration() const noexcept {
    return std::numeric_limits<double>::infinity();
  }
};

using WarpPtr = std::shared_ptr<const Warp>;  ///< Null if the motion is rigid.

/// A warp, linearised about a place and a time: X = slope x + origin + rate (t - time), in the
/// resting frame. The default is the identity.
struct Deformation {
  Mat3 slope = Mat3::Identity();  ///< F = dX/dx
  Mat3 back = Mat3::Identity();   ///< F^-1
  Vec3 origin = Vec3::Zero();     ///< X at x = 0 and t = `time`, by this linear map [m]
  Vec3 rate = Vec3::Zero();       ///< du/dt [m/s]
  double time = 0.0;              ///< Time of the reading [s].
  Vec3 at = Vec3::Zero();         ///< Place x of the reading [m].
  std::array<Mat3, 3> bend{Mat3::Zero(), Mat3::Zero(),
                           Mat3::Zero()};  ///< d^2 X_i / dx_j dx_k [1/m]

  /// Estimates the error of X at x and `when` [m] by the second-order terms in place and in time.
  /// `acceleration` is Warp::topAcceleration(). Neglects the mixed term |dF/dt| |x - at| |when -
  /// time|: each slice of a tick reads the warp, so x and `when` are near. If F changes by 10 per
  /// second, the term is 0.01 voxel for a voxel and 1 ms.
  [[nodiscard]] double errorAt(const Vec3& x, double when, double acceleration) const noexcept {
    const double later = when - time;
    const double bent =
        std::sqrt(bend[0].squaredNorm() + bend[1].squaredNorm() + bend[2].squaredNorm());
    const double way = (x - at).squaredNorm();
    return 0.5 * ((later == 0.0 ? 0.0 : acceleration * later * later) + bent * way);
  }
  /// Returns the change of F along w: element (i, j) is the sum over k of d^2 X_i / dx_j dx_k w_k.
  [[nodiscard]] Mat3 bendAlong(const Vec3& w) const noexcept {
    Mat3 out;
    out << (bend[0] * w).transpose(), (bend[1] * w).transpose(), (bend[2] * w).transpose();
    return out;
  }
  /// Returns sum g_i bend_i, the warp's part of a gradient's derivative, in the resting frame.
  [[nodiscard]] Mat3 bendOf(const Vec3& g) const noexcept {
    return g.x() * bend[0] + g.y() * bend[1] + g.z() * bend[2];
  }
};

/// Returns the deformation about x [m], with one reading. If det F < 0.05, u folds space or almost
/// does, and the identity replaces F. RT: no allocation.
[[nodiscard]] Deformation deformationAt(const Warp& warp, const Vec3& x,
                                        double time) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
