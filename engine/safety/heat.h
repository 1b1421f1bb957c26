/// The force limit that follows from the heat of the motors.
#pragma once

#include "palpate/engine/types.h"

namespace palpate {

inline constexpr double kWarm = 0.8;  ///< Above this share of continuous^2, heat reduces the force.

/// Returns the largest force that motors with this heat may give: `peak` up to kWarm times
/// continuous^2, then less, and `continuous` at continuous^2 or more.
/// @param continuous  Force that the motors can hold without end, in the unit of `peak`. If it is
///                    <= 0 or >= peak, the function returns the peak.
/// @param heat        Mean of the squares of the sent force: LimiterState::heat.
/// RT: no allocation.
[[nodiscard]] double allowedByHeat(double continuous, double peak,
                                   double heat) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
