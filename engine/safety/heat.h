/// The share of its peak force that the motors' heat still allows.
#pragma once

#include "palpate/engine/types.h"

namespace palpate {

inline constexpr double kWarm = 0.8;  ///< Share of the heat at which a continuous limit sets in.

/// Returns the force that the heat allows to motors that can hold `continuous` for ever: `peak` up
/// to kWarm of continuous^2, less from there on, and `continuous` at continuous^2 and beyond.
///
/// @param continuous  In any unit; <= 0, or >= peak: only the peak limits.
/// @param heat        Mean of the squares of the sent force, as LimiterState::heat.
/// RT: no allocation.
[[nodiscard]] double allowedByHeat(double continuous, double peak,
                                   double heat) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
