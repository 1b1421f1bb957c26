/// What the user of a window asks of a run, out of memory that is another process's: whatever is in
/// it, what comes of it is in bounds.
#pragma once

#include <cstdint>
#include <vector>

#include "palpate/devices/simulated_device.h"
#include "palpate/scenes/live.h"

namespace palpate::cli {

/// What is asked that was not before.
struct Asked {
  bool cut = false;             ///< The force is to be cut.
  bool clear = false;           ///< It is to be let out again; not with `cut`, which stays.
  bool closed = false;          ///< The window was closed.
  std::uint64_t dialled = 0;    ///< LiveWishes::dialled, where dials were turned; 0: none were.
  std::vector<LiveDial> dials;  ///< With `dialled`: all, 0 to kMostDial.
};
[[nodiscard]] Asked asked(const LiveWishes& before, const LiveWishes& now);

/// A hand that follows a mouse from `start` [m] as through a low-pass, no faster than a hand may be
/// (WatchLimits::max_speed): a mouse leaps, thirty times a second. `mouse` outlives it.
[[nodiscard]] HandTarget behindMouse(const Published<LiveHand>& mouse, const Vec3& start);

}  // namespace palpate::cli
