/// How hot a motor is, by what it has been told, and how much it may be told for that.
#pragma once

#include "palpate/engine/types.h"

namespace palpate {

/// Its winding's heat follows the square of its current with one time constant; at what it can hold
/// for ever it is as hot as it may be. While cool it may have its peak, from kWarm of that heat on
/// less (allowedByHeat), at all of it what it can hold: its heat never goes beyond, also where what
/// it is told holds for kHold, until a guardian takes it off. It begins as hot as it may be: what
/// it did before nobody knows.
class MotorHeat {
 public:
  static constexpr double kHold = 0.02;  ///< [s]

  /// @param continuous  What it can hold for ever, in any unit; 0: all that it is ever told.
  /// @param heating     [s], of its winding; > 0 where continuous is.
  MotorHeat(double continuous, double heating) noexcept
      : continuous_(continuous), heating_(heating), heat_(continuous * continuous) {}

  /// Time has passed [s] with what it was told last. RT: no allocation.
  void pass(double dt) noexcept PALPATE_NONBLOCKING;
  /// The most that it may be told now, up to `peak`. RT: no allocation.
  [[nodiscard]] double allows(double peak) const noexcept PALPATE_NONBLOCKING;
  void tell(double value) noexcept PALPATE_NONBLOCKING { told_ = value; }  ///< In its unit; lasts.

 private:
  double continuous_, heating_;
  double heat_;  ///< Mean of the squares of what it was told.
  double told_ = 0.0;
};

}  // namespace palpate
