/// The window of a run: palpate-view, a program of its own, and what its user asks of the loop.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "palpate/engine/haptic_thread.h"
#include "palpate/engine/scene.h"
#include "palpate/scenes/cli/asked.h"
#include "palpate/scenes/live.h"

namespace palpate::cli {

/// Shares a run with a window, while both live. Nothing here can hold up a loop, and the window's
/// end is not the run's, unless its user has closed it.
// As the mailbox of its writer.
class Window {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Makes the memory that is shared. Throws Error where palpate-view is not installed.
  explicit Window(double rate);
  /// Says that the run is over, and sees the window off.
  ~Window();
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;

  /// Starts the program on a scene, which is drawn anew when its file changes where `watch` says
  /// so. `only`: its mouse leads all hands, so that the run ends with it, however it ends. Throws
  /// Error.
  void open(const std::string& scene, bool watch, bool only);
  /// Has a picture made of what was told last, and waits for it. Throws Error where there is none,
  /// and Interrupted, with the program's end, where the user ends the run meanwhile.
  void draw(const std::string& scene, const std::string& picture);

  /// Takes ticks, for one hand.
  [[nodiscard]] LiveWriter& writer() noexcept { return writer_; }
  /// The hand that its mouse leads; first at `start` [m].
  [[nodiscard]] HandTarget mouse(const Vec3& start) {
    return behindMouse(share_.block().hand, start);
  }

  /// Cuts and clears as was asked since the last look; what else was asked is the caller's to do.
  [[nodiscard]] Asked look(const std::vector<HapticThread*>& hands);
  /// Says that the dials of a request (Asked::dialled) cannot be felt.
  void tellRefused(std::uint64_t request) noexcept { share_.block().refused = request; }
  /// It has ended otherwise than by being closed, and no hand is left.
  [[nodiscard]] bool lost() const noexcept { return lost_; }

 private:
  void start(const std::vector<std::string>& arguments);
  /// The status with which the program has ended, -1 where nobody knows it; nothing while it runs.
  std::optional<int> ended();

  LiveShare share_;
  LiveWriter writer_;
  LiveWishes wishes_;  ///< As last read.
  bool only_ = false;
  bool lost_ = false;
  int child_ = -1;  ///< -1: none, or it has ended.
};

}  // namespace palpate::cli
