/// How much of its peak what heats up may still have.
#pragma once

#include "palpate/engine/types.h"

namespace palpate {

inline constexpr double kWarm = 0.8;  ///< Share of the heat at which a continuous limit sets in.

/// What is left of `peak` for what can hold `continuous` for ever and is so hot: all of it up to
/// kWarm of continuous^2, from there on less, at continuous^2 and beyond just that.
///
/// @param continuous  In any unit; <= 0, or >= peak: nothing but the peak limits it.
/// @param heat        Mean of the squares of what it had, as LimiterState::heat.
/// RT: no allocation.
[[nodiscard]] double allowedByHeat(double continuous, double peak,
                                   double heat) noexcept PALPATE_NONBLOCKING;

}  // namespace palpate
