/// The X server for drawing: the user's, or for pictures one of our own.
#pragma once

namespace palpate::view {

/// Ensures that a display with OpenGL exists. If it is missing and `picture` is set, starts Xvfb
/// until the program ends. Throws Error. If the display is later lost or refuses a request, this
/// program alone prints one line and ends. Call it before any function of VTK.
void needDisplay(bool picture);

/// Reports whether any part of a window is visible. Uses a connection of its own, because VTK's
/// connection drops events that it does not know.
class Sight {
 public:
  /// `window`: the window's number. Call after needDisplay(). The window counts as visible until an
  /// event reports otherwise.
  explicit Sight(unsigned long window);

  /// Returns the last reported state.
  [[nodiscard]] bool now();

 private:
  bool mapped_ = true;
  bool covered_ = false;
};

}  // namespace palpate::view
