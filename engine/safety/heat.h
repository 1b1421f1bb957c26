/// The force limit that follows from the heat of the motors.
#pragma once

#include "palpate/engine/types.h"

namespace palpate {

inline constexpr double kWarm = 0.8;  ///< Share of the heat from which on the force is reduced.

/// Returns the largest force that motors with this heat may give: `peak` up to kWarm times
/// continuous^2, then less, and `continuous` at continuous^2 or more.
/// @param continuous  Force that the motors can hold for ever, in any unit. If <= 0 or >= peak,
///                    only the peak limits.
/// @param heat        Mean of the squares of the sent force: LimiterState::heat.
/// RT: no allocation.
[[nodiscard]] double allowedByHeat(double continuous, double peak,
                                   double heat) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
