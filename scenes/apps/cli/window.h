/// Starts the window's program, palpate-view, and takes the requests of its user.
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

/// Shares a run with a window. Never blocks a haptic loop. If the window's program ends
/// unexpectedly, the run continues; if the user closes the window, the run ends.
// The mailbox in the writer has padding.
class Window {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Creates the memory that is shared with the window. Throws Error if palpate-view is not
  /// installed.
  explicit Window(double rate);
  /// Reports to the window that the run has ended, and waits until the window closes. Kills its
  /// program after 1.5 s.
  ~Window();
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;

  /// Starts the window's program with a scene. Throws Error.
  ///
  /// @param watch     If true, the window draws the scene again when the scene file changes.
  /// @param only      True if the mouse leads all hands. The run then ends with the window in any
  ///                  case.
  /// @param reengage  LoopParams::reengage of the loop [s], for the panel.
  void open(const std::string& scene, bool watch, bool only, double reengage);
  /// Requests a picture of the last tick, and waits until it is drawn. Throws Error if it cannot be
  /// drawn. If the user interrupts, ends the window's program and throws Interrupted.
  void draw(const std::string& scene, const std::string& picture);

  /// Returns the writer that publishes the ticks of a hand to the window.
  [[nodiscard]] LiveWriter& writer() noexcept { return writer_; }
  /// Returns the hand that the mouse leads. It starts at `start` [m].
  [[nodiscard]] HandTarget mouse(const Vec3& start) {
    return behindMouse(share_.block().hand, start);
  }

  /// Carries out requests to cut or restore the force since the last call. Returns all requests, so
  /// that the caller can carry out the others.
  [[nodiscard]] Asked look(const std::vector<HapticThread*>& hands);
  /// Reports to the window that the gains of a request (Asked::dialled) were rejected.
  void tellRefused(std::uint64_t request) noexcept { share_.block().refused = request; }
  /// Returns true if the window's program has ended unexpectedly and the mouse led all hands.
  [[nodiscard]] bool lost() const noexcept { return lost_; }

 private:
  void start(const std::vector<std::string>& arguments);
  /// Returns the exit status of the window's program, or -1 if it is unknown. Returns no value
  /// while the program runs.
  std::optional<int> ended();

  LiveShare share_;
  LiveWriter writer_;
  LiveWishes wishes_;  ///< Requests of the window as last read.
  bool only_ = false;
  bool lost_ = false;
  int child_ = -1;  ///< Process id of the window's program; -1: not running.
};

}  // namespace palpate::cli
