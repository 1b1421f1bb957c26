/// Keeps a rendered picture, colours and depths, and puts it back in each frame: unchanged parts
/// are drawn once.
#pragma once

#include <vtkOpenGLFramebufferObject.h>
#include <vtkOpenGLRenderWindow.h>
#include <vtkSmartPointer.h>

namespace palpate::view {

/// A part of a window, from its lower left corner [pixels].
struct Area {
  int left = 0;
  int low = 0;
  int right = 0;  ///< One after the last pixel; not more than `left`: empty.
  int high = 0;

  [[nodiscard]] bool empty() const noexcept { return right <= left || high <= low; }
  /// Returns the smallest area that contains both.
  [[nodiscard]] Area with(const Area& other) const noexcept;
};

/// Colours and depths of a window at some time.
class KeptImage {
 public:
  /// Takes the last rendering of the window.
  void take(vtkOpenGLRenderWindow& window);
  /// Copies a part back into the window's rendering, between the start of a frame and the drawing
  /// on it. Has no effect before take(), or if the size of the window has changed.
  void putBack(vtkOpenGLRenderWindow& window, const Area& part) const;
  /// Frees the graphics resources.
  void release(vtkOpenGLRenderWindow& window);

 private:
  vtkSmartPointer<vtkOpenGLFramebufferObject> image_;
  int size_[2] = {0, 0};
};

}  // namespace palpate::view
