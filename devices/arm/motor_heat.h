/// Estimates the heat of a motor from its commands, and limits the next command so that the motor
/// stays cool enough.
#pragma once

#include "palpate/engine/types.h"

namespace palpate {

/// Model: a winding's heat follows the square of its command with one time constant. The limit is
/// the heat of the command that the motor can hold forever (`continuous`). Up to the share kWarm
/// (engine/safety/heat.h) of the limit, a motor may get its peak command; above, the allowed
/// command falls (allowedByHeat). At the limit it is `continuous`. In addition, a command is so
/// small that the heat stays within the limit if the program stops and this command stays for
/// kHold. A motor starts at the limit, because its earlier use is unknown.
class MotorHeat {
 public:
  /// Assumed longest time for which the last command stays on after the program stops [s].
  static constexpr double kHold = 0.02;

  /// @param continuous  Command that the motor can hold forever, in any unit; 0: no limit.
  /// @param heating Time constant of its winding's heat [s]; must be > 0 if `continuous` > 0.
  MotorHeat(double continuous, double heating) noexcept
      : continuous_(continuous), heating_(heating), heat_(continuous * continuous) {}

  /// Advances the heat by `dt` [s] at the last command. RT: no allocation.
  void pass(double dt) noexcept PALPATE_NONBLOCKING;
  /// Returns the largest command that is allowed now, up to `peak`. RT: no allocation.
  [[nodiscard]] double allows(double peak) const noexcept PALPATE_NONBLOCKING;
  /// Sets the command that the motor gets until the next call.
  void tell(double value) noexcept PALPATE_NONBLOCKING { told_ = value; }

 private:
  double continuous_, heating_;
  double heat_;
  double told_ = 0.0;
};

}  // namespace palpate
