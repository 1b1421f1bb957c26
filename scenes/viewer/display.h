/// The X server that draws: the user's, or for pictures one of our own.
#pragma once

namespace palpate::view {

/// Sees that there is a display with OpenGL. For a picture, where there is none, starts Xvfb until
/// the program ends. Throws Error. From then on a display that is lost, or refuses what it is asked
/// for, is one line and the end of this program alone. Before anything of VTK's.
void needDisplay(bool picture);

/// Whether any of a window can be seen. By a connection that is not VTK's, which drops what it does
/// not know.
class Sight {
 public:
  /// `window`: its number. After needDisplay(). Until something else is told it is seen.
  explicit Sight(unsigned long window);

  /// As was told last.
  [[nodiscard]] bool now();

 private:
  bool mapped_ = true;
  bool covered_ = false;
};

}  // namespace palpate::view
