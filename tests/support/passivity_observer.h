/// The passivity observer and controller of Hannaford and Ryu (2002), time domain, impedance
/// causal: what was there before the energy tank.
#pragma once

#include "palpate/engine/types.h"

namespace palpate::methods {

/// Sums the work at the port as software sees it; when the sum is negative a damper, as strong as
/// would bring it back to zero over the step just gone, is added to the force.
///
/// It knows neither the encoder's error, nor delay, nor the arm's friction, and acts a step late:
/// tests/engine/passivity_test.cpp counts how often energy comes out all the same.
class PassivityObserver {
 public:
  /// @param wanted  Force on the hand [N].
  /// @param hand    As read [m].
  /// @param dt      Since the last call [s], > 0.
  /// @param peak    The most that the device gives [N].
  [[nodiscard]] Vec3 control(const Vec3& wanted, const Vec3& hand, double dt, double peak) noexcept;

 private:
  bool known_ = false;
  Vec3 last_ = Vec3::Zero();
  Vec3 sent_ = Vec3::Zero();
  double energy_ = 0.0;
};

}  // namespace palpate::methods
