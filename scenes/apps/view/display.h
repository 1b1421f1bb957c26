/// Finds or starts the X server on which this program draws.
#pragma once

namespace palpate::view {

/// Requires a display with OpenGL. If there is no such display and `picture` is true, starts Xvfb,
/// which ends with this program. Throws Error. If the display is lost later or rejects a request
/// (other than to set the focus), this process prints one line and ends. Call this before any
/// function of VTK.
void needDisplay(bool picture);

/// Reports whether any part of a window is visible. Has a connection to the X server besides VTK's,
/// because VTK discards these events.
class Sight {
 public:
  /// `window` is an X id. A window counts as visible until its first event.
  explicit Sight(unsigned long window);

  [[nodiscard]] bool now();

 private:
  bool mapped_ = true;
  bool covered_ = false;
};

}  // namespace palpate::view
