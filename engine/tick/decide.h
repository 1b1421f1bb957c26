/// The decision after a trial step of the proxy: read again, arrive, wait, or go to the hand.
#pragma once

#include <cstdint>

namespace palpate {

/// What a slice of a tick does after a trial step.
enum class Next : std::uint8_t {
  kRead,     ///< Read properties at the step's end, and balance again.
  kArrive,   ///< End at the answer: the rest is within the tolerance.
  kWait,     ///< End where the primitives let the proxy go: the readings are used up.
  kRelease,  ///< Go to the hand: no primitive holds the proxy.
};

/// A trial step, after it was computed.
struct TrialState {
  bool read = false;    ///< Properties were read in this slice.
  bool within = false;  ///< The reading holds at the target, and the rest is within the tolerance.
  bool spent = false;   ///< Readings, balances or choices of parts are used up, or a stream stalls.
  bool held = false;    ///< The last balance has a primitive.
};

/// Returns the next action. The first trial step of a slice always leads to a reading.
[[nodiscard]] constexpr Next decide(const TrialState& state) noexcept {
  if (!state.read) return Next::kRead;
  if (state.within) return Next::kArrive;
  if (!state.spent) return Next::kRead;
  return state.held ? Next::kWait : Next::kRelease;
}

/// The step of a proxy that no primitive holds, which is only swept for surfaces up to the hand.
struct SweepState {
  bool complete = false;    ///< The sweep reached the hand.
  bool strays = false;      ///< The sweep led beyond the chosen parts.
  bool chosen_out = false;  ///< No further choice of parts is left.
  bool met_before = false;  ///< An earlier sweep of this slice has ended at a surface.
};

/// Returns the next action: a reading at a surface that the sweep reached for the first time, or
/// where new parts are chosen; else the proxy is released.
[[nodiscard]] constexpr Next decide(const SweepState& state) noexcept {
  if (state.complete) return Next::kRelease;
  const bool again = state.strays ? state.chosen_out : state.met_before;
  return again ? Next::kRelease : Next::kRead;
}

}  // namespace palpate
