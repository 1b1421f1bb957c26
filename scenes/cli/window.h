/// The window of a run: palpate-view, a program of its own, and what its user asks of the loop.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "palpate/devices/simulated_device.h"
#include "palpate/engine/haptic_thread.h"
#include "palpate/engine/scene.h"
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
  /// so. Throws Error.
  void open(const std::string& scene, bool watch);
  /// Has a picture made of what was told last, and waits for it. Throws Error where there is none.
  void draw(const std::string& scene, const std::string& picture);

  /// Takes ticks, for one hand.
  [[nodiscard]] LiveWriter& writer() noexcept { return writer_; }
  /// Where the mouse means the hand to be; first at `start` [m].
  [[nodiscard]] HandTarget mouse(const Vec3& start);

  /// Does what was asked of the loop. False where the run is to end: the window was closed.
  [[nodiscard]] bool look(const std::vector<HapticThread*>& hands);
  /// Factors of the modes' strengths (LiveWishes::dials), where they have changed since.
  [[nodiscard]] std::optional<std::vector<double>> dialled();

 private:
  void start(const std::vector<std::string>& arguments);

  LiveShare share_;
  LiveWriter writer_;
  LiveWishes wishes_;  ///< As last read.
  std::uint64_t dialled_ = 0;
  int child_ = -1;  ///< -1: none, or it has ended.
};

}  // namespace palpate::cli
