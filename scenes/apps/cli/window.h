/// Runs the window program, palpate-view, and takes its user's requests.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "palpate/engine/loop/haptic_thread.h"
#include "palpate/engine/scene/scene.h"
#include "palpate/scenes/apps/common/asked.h"
#include "palpate/scenes/library/live.h"

namespace palpate::cli {

/// Shares a run with a window, while both live. Never blocks a loop. The end of the window does not
/// end the run, unless its user has closed it.
// The writer's mailbox is padded.
class Window {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Creates the shared memory. Throws Error if palpate-view is not installed.
  explicit Window(double rate);
  /// Reports the end of the run, and waits for the window to close; kills it after 1.5 s.
  ~Window();
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;

  /// Starts the program on a scene. If `watch`, the program draws the scene again when its file
  /// changes. `only`: the mouse leads all hands, so that the run ends with the program in any case.
  /// Throws Error.
  ///
  /// @param reengage  LoopParams::reengage of the loop [s], for the panel.
  void open(const std::string& scene, bool watch, bool only, double reengage);
  /// Requests a picture of the last tick, and waits for it. Throws Error if no picture was drawn.
  /// If the user ends the run in the meantime, ends the program and throws Interrupted.
  void draw(const std::string& scene, const std::string& picture);

  /// Returns the writer, which takes ticks of one hand.
  [[nodiscard]] LiveWriter& writer() noexcept { return writer_; }
  /// Returns the hand that the mouse leads; first at `start` [m].
  [[nodiscard]] HandTarget mouse(const Vec3& start) {
    return behindMouse(share_.block().hand, start);
  }

  /// Cuts and clears as requested since the last look; returns all requests, for the caller to do
  /// the rest.
  [[nodiscard]] Asked look(const std::vector<HapticThread*>& hands);
  /// Reports that the gains of a request (Asked::dialled) are rejected.
  void tellRefused(std::uint64_t request) noexcept { share_.block().refused = request; }
  /// Returns true if the window has ended without being closed, and no hand is left.
  [[nodiscard]] bool lost() const noexcept { return lost_; }

 private:
  void start(const std::vector<std::string>& arguments);
  /// Returns the program's exit status, -1 if not known; unset while it runs.
  std::optional<int> ended();

  LiveShare share_;
  LiveWriter writer_;
  LiveWishes wishes_;  ///< Requests as last read.
  bool only_ = false;
  bool lost_ = false;
  int child_ = -1;  ///< -1: not started, or ended.
};

}  // namespace palpate::cli
