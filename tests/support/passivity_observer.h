/// The passivity observer and controller of Hannaford and Ryu (2002), time domain, impedance
/// causal. The engine used it before the energy tank.
#pragma once

#include "palpate/engine/types.h"

namespace palpate::methods {

/// Sums the work at the port as the software sees it. If the sum is negative, control() adds a
/// damping force that would have returned the sum to zero in the previous step.
///
/// The observer does not know the encoder's error, the delay or the arm's friction, and acts a step
/// late. tests/engine/passivity_test.cpp counts how often the hand still gains energy.
class PassivityObserver {
 public:
  /// @param wanted  Force on the hand [N].
  /// @param hand    Reading of the hand [m].
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
