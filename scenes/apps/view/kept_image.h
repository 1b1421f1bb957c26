/// Stores a rendered picture and restores it in later frames, so that static parts are drawn once.
#pragma once

#include <vtkOpenGLFramebufferObject.h>
#include <vtkOpenGLRenderWindow.h>
#include <vtkSmartPointer.h>

namespace palpate::view {

/// A rectangle of a window [pixels], measured from the window's lower left corner.
struct Area {
  int left = 0;
  int low = 0;
  int right = 0;  ///< One more than the last pixel.
  int high = 0;

  [[nodiscard]] bool empty() const noexcept { return right <= left || high <= low; }
  /// Returns the smallest area that contains this area and `other`.
  [[nodiscard]] Area with(const Area& other) const noexcept;
};

class KeptImage {
 public:
  void take(vtkOpenGLRenderWindow& window);
  /// Copies a part of the picture into the window. Call it when a frame has started, before
  /// drawing. Has no effect unless the stored picture has the window's size.
  void putBack(vtkOpenGLRenderWindow& window, const Area& part) const;
  /// Frees the textures on the graphics card.
  void release(vtkOpenGLRenderWindow& window);

 private:
  vtkSmartPointer<vtkOpenGLFramebufferObject> image_;
  int size_[2] = {0, 0};
};

}  // namespace palpate::view
