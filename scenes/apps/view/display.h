/// The X server on which this program draws: the user's server, or Xvfb for a picture without a
/// window.
#pragma once

namespace palpate::view {

/// Makes sure that a display with OpenGL exists. If there is none and `picture` is true, starts
/// Xvfb, which ends with this program. Throws Error. If the display is lost later, or rejects a
/// request, this process prints one line and ends; the loop continues. Call this function before
/// any function of VTK.
void needDisplay(bool picture);

/// Observes whether any part of a window is visible. Uses a connection of its own, because VTK
/// discards the events that report this.
class Sight {
 public:
  /// `window` is the X id of the window. Call this after needDisplay(). Until an event reports
  /// otherwise, the window counts as visible.
  explicit Sight(unsigned long window);

  /// Returns true if the window is visible according to the last event.
  [[nodiscard]] bool now();

 private:
  bool mapped_ = true;
  bool covered_ = false;
};

}  // namespace palpate::view
