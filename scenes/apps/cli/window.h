/// Starts the window's program, palpate-view, and receives its user's requests.
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

/// Shares a run with a window. Never blocks a haptic loop. If the user closes the window, the run
/// ends; if the window's program fails, the run continues, unless the mouse leads all hands.
// Padding is intended: the mailbox in the writer keeps its threads' data apart.
class Window {  // NOLINT(clang-analyzer-optin.performance.Padding)
 public:
  /// Creates the shared memory. Throws Error if this fails, or if palpate-view is not installed.
  explicit Window(double rate);
  /// Signals the end of the run to the window. Kills palpate-view if it still runs after 1.5 s.
  ~Window();
  Window(const Window&) = delete;
  Window& operator=(const Window&) = delete;

  /// Starts the window's program with a scene. Throws Error.
  /// @param watch     If true, draws the scene again when its file changes.
  /// @param only      True if the mouse leads all hands: then the run ends however the window ends.
  /// @param reengage  LoopParams::reengage of the loop [s], for the panel.
  void open(const std::string& scene, bool watch, bool only, double reengage);
  /// Draws the last tick into a file. Throws Error, and Interrupted after an interrupt.
  /// @param view  Options of palpate-view for the picture, such as --camera and a side.
  void draw(const std::string& scene, const std::string& picture,
            const std::vector<std::string>& view);

  [[nodiscard]] LiveWriter& writer() noexcept { return writer_; }
  /// Returns the hand that the mouse leads. The hand starts at `start` [m].
  [[nodiscard]] HandTarget mouse(const Vec3& start) {
    return behindMouse(share_.block().hand, start);
  }

  /// Carries out new requests to cut or restore the force. Returns all new requests of the user.
  [[nodiscard]] Asked look(const std::vector<HapticThread*>& hands);
  /// Reports to the window that the gains of a request (Asked::dialled) were rejected.
  void tellRefused(std::uint64_t request) noexcept { share_.block().refused = request; }
  /// Returns true if palpate-view has ended unexpectedly while the mouse led all hands.
  [[nodiscard]] bool lost() const noexcept { return lost_; }

 private:
  void start(const std::vector<std::string>& arguments);
  /// Returns the exit status of palpate-view, or -1 if it is unknown; no value while it runs.
  std::optional<int> ended();

  LiveShare share_;
  LiveWriter writer_;
  LiveWishes wishes_;
  bool only_ = false;
  bool lost_ = false;
  int child_ = -1;  ///< Process id of palpate-view; -1: not running.
};

}  // namespace palpate::cli
