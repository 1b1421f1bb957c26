/// The decision after a trial step of the proxy: read again, arrive, wait or release.
#pragma once

#include <cstdint>

namespace palpate {

/// The next action in a slice of a tick, after a trial step.
enum class Next : std::uint8_t {
  kRead,     ///< Read properties at the end of the step, and balance again.
  kArrive,   ///< End at answer() (iteration.h): the remaining error is within the tolerance.
  kWait,     ///< End as far as the primitives allow, because no readings are left.
  kRelease,  ///< Move the proxy to the hand, because no primitive holds it.
};

/// State of the iteration after a trial step.
struct TrialState {
  bool read = false;  ///< True if properties were read in this slice.
  bool within =
      false;  ///< True if the reading is valid at the target, and the error within the tolerance.
  /// True if no readings, iterations or choices of parts are left, or if a stream stalls.
  bool spent = false;
  bool held = false;  ///< True if the last balance contains a primitive.
};

/// Returns the next action. The first trial step of a slice always leads to a reading.
[[nodiscard]] constexpr Next decide(const TrialState& state) noexcept {
  if (!state.read) return Next::kRead;
  if (state.within) return Next::kArrive;
  if (!state.spent) return Next::kRead;
  return state.held ? Next::kWait : Next::kRelease;
}

/// State of a sweep to the hand, which searches for surfaces, if no primitive holds the proxy.
struct SweepState {
  bool complete = false;    ///< True if the sweep reached the hand.
  bool strays = false;      ///< True if the sweep led beyond the chosen parts.
  bool chosen_out = false;  ///< True if the limit on choices of parts is reached.
  bool met_before = false;  ///< True if an earlier sweep in this slice ended at a surface.
};

/// Returns kRead at the first surface, or if new parts can be chosen; else kRelease.
[[nodiscard]] constexpr Next decide(const SweepState& state) noexcept {
  if (state.complete) return Next::kRelease;
  const bool again = state.strays ? state.chosen_out : state.met_before;
  return again ? Next::kRelease : Next::kRead;
}

}  // namespace palpate
