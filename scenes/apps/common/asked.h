/// Reads what the user of a window requests of a run, from memory of another process. For any
/// content of the memory the results are in bounds.
#pragma once

#include <cstdint>
#include <vector>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/scenes/library/live.h"

namespace palpate::cli {

/// New requests.
struct Asked {
  bool cut = false;             ///< Cut the force.
  bool clear = false;           ///< Restore the force; never together with `cut`, which has
                                ///< priority.
  bool closed = false;          ///< The window was closed.
  std::uint64_t dialled = 0;    ///< LiveWishes::dialled if dials were turned; else 0.
  std::vector<LiveDial> dials;  ///< With `dialled`: all dials, each 0 to kMostDial.
};
[[nodiscard]] Asked asked(const LiveWishes& before, const LiveWishes& now);

/// Returns a hand that follows a mouse from `start` [m] through a low-pass filter, no faster than a
/// hand may move (WatchLimits::max_speed): a mouse jumps, thirty times a second. `mouse` must
/// outlive it.
[[nodiscard]] HandTarget behindMouse(const Published<LiveHand>& mouse, const Vec3& start);

}  // namespace palpate::cli
