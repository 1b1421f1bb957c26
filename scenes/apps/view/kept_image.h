/// Stores a rendered picture with its colours and depths, and copies it back in each frame, so that
/// the parts that do not change are drawn only once.
#pragma once

#include <vtkOpenGLFramebufferObject.h>
#include <vtkOpenGLRenderWindow.h>
#include <vtkSmartPointer.h>

namespace palpate::view {

/// A rectangle in a window, measured from the window's lower left corner [pixels].
struct Area {
  int left = 0;
  int low = 0;
  int right = 0;  ///< One more than the last pixel; if not greater than `left`, the area is empty.
  int high = 0;

  [[nodiscard]] bool empty() const noexcept { return right <= left || high <= low; }
  /// Returns the smallest area that contains this area and `other`.
  [[nodiscard]] Area with(const Area& other) const noexcept;
};

/// Stored colours and depths of a window.
class KeptImage {
 public:
  /// Stores the last rendering of the window.
  void take(vtkOpenGLRenderWindow& window);
  /// Copies a part of the stored picture into the window. Call it after the start of a frame and
  /// before drawing. Does nothing before the first take(), or if the size of the window has changed
  /// since.
  void putBack(vtkOpenGLRenderWindow& window, const Area& part) const;
  /// Frees the textures on the graphics card.
  void release(vtkOpenGLRenderWindow& window);

 private:
  vtkSmartPointer<vtkOpenGLFramebufferObject> image_;
  int size_[2] = {0, 0};
};

}  // namespace palpate::view
