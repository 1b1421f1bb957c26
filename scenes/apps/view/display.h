/// The X server on which this program draws: the user's server, or Xvfb for a still picture.
#pragma once

namespace palpate::view {

/// Requires a display with OpenGL. If `picture` is true, starts Xvfb when the display is missing.
/// Xvfb ends with this program. Throws Error. If the display is lost later or rejects a request,
/// this process prints one line and ends. Call this before any function of VTK.
void needDisplay(bool picture);

/// Observes whether any part of a window is visible. Has its own connection to the X server,
/// because VTK discards these events.
class Sight {
 public:
  /// `window` is an X id. Before the first event, the window counts as visible.
  explicit Sight(unsigned long window);

  [[nodiscard]] bool now();

 private:
  bool mapped_ = true;
  bool covered_ = false;
};

}  // namespace palpate::view
