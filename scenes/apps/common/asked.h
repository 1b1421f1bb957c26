/// Reads a window's requests from memory that another process writes. Gains and positions are
/// limited to their ranges, because this memory may contain any numbers.
#pragma once

#include <cstdint>
#include <vector>

#include "palpate/devices/simulated/simulated_device.h"
#include "palpate/scenes/library/live.h"

namespace palpate::cli {

struct Asked {
  bool cut = false;
  bool clear = false;  ///< Restore the force; false if `cut`.
  bool closed = false;
  std::uint64_t dialled = 0;    ///< LiveWishes::dialled if the user has changed gains; else 0.
  std::vector<LiveDial> dials;  ///< New gains, each from 0 to kMostDial.
};
[[nodiscard]] Asked asked(const LiveWishes& before, const LiveWishes& now);

/// Returns a hand that follows the mouse from `start` [m], below WatchLimits::max_speed. A low-pass
/// filter smooths the steps between the mouse's positions. `mouse` must outlive the result.
[[nodiscard]] HandTarget behindMouse(const Published<LiveHand>& mouse, const Vec3& start);

}  // namespace palpate::cli
