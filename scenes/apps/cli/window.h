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

/// Shares a run with a window. Never blocks a haptic loop. The run ends if the user closes the
/// window, but continues if the window's program fails.
// The mailbox in the writer has padding.
class Window {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Creates the shared memory. Throws Error if palpate-view is not installed.
  explicit Window(double rate);
  /// Reports the end of the run to the window. Kills its program if it still runs after 1.5 s.
  ~Window();
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;

  /// Starts the window's program with a scene. Throws Error.
  /// @param watch     The window draws the scene again when its file changes.
  /// @param only      The mouse leads all hands: the run ends with the window in any case.
  /// @param reengage  LoopParams::reengage of the loop [s], for the panel.
  void open(const std::string& scene, bool watch, bool only, double reengage);
  /// Draws the last tick into a file. Throws Error, and Interrupted after an interrupt.
  void draw(const std::string& scene, const std::string& picture);

  [[nodiscard]] LiveWriter& writer() noexcept { return writer_; }
  /// Returns the hand that the mouse leads. It starts at `start` [m].
  [[nodiscard]] HandTarget mouse(const Vec3& start) {
    return behindMouse(share_.block().hand, start);
  }

  /// Carries out new requests to cut or restore the force. Returns all new requests.
  [[nodiscard]] Asked look(const std::vector<HapticThread*>& hands);
  /// Reports to the window that the gains of a request (Asked::dialled) were rejected.
  void tellRefused(std::uint64_t request) noexcept { share_.block().refused = request; }
  /// Returns true if the window's program has ended unexpectedly and the mouse led all hands.
  [[nodiscard]] bool lost() const noexcept { return lost_; }

 private:
  void start(const std::vector<std::string>& arguments);
  /// Returns the exit status of the window's program, -1 if unknown; no value while it runs.
  std::optional<int> ended();

  LiveShare share_;
  LiveWriter writer_;
  LiveWishes wishes_;
  bool only_ = false;
  bool lost_ = false;
  int child_ = -1;  ///< Process id of the window's program; -1: not running.
};

}  // namespace palpate::cli
