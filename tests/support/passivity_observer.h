/// The time-domain passivity observer and controller of Hannaford and Ryu (2002), impedance type.
/// Tests compare the energy tank with it.
#pragma once

#include "palpate/engine/types.h"

namespace palpate::methods {

/// Sums the work at the port as software can compute it. If the sum is negative, control() adds
/// damping that would have made the sum zero in the last step. The observer ignores encoder error,
/// delay and the arm's friction, and acts one step late. passivity_test.cpp counts how often hands
/// still gain energy.
class PassivityObserver {
 public:
  /// Returns the force to send [N].
  /// @param wanted  The scene's force on the hand [N].
  /// @param hand    Position reading of the hand [m].
  /// @param dt      Time since the last call [s], > 0.
  /// @param peak    The device's largest force [N].
  [[nodiscard]] Vec3 control(const Vec3& wanted, const Vec3& hand, double dt, double peak) noexcept;

 private:
  bool known_ = false;
  Vec3 last_ = Vec3::Zero();
  Vec3 sent_ = Vec3::Zero();
  double energy_ = 0.0;
};

}  // namespace palpate::methods
