/// The X server that draws: the user's, or for pictures one of our own.
#pragma once

namespace palpate::view {

/// Sees that there is a display. For a picture, where there is none, starts Xvfb until the program
/// ends. Throws Error. Before anything of VTK's.
void needDisplay(bool picture);

/// What to do when the display is lost: one line, and the end of this program alone.
void endWithDisplay();

}  // namespace palpate::view
