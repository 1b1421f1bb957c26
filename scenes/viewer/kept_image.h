/// A rendered picture, colours and depths, put back each frame: what does not change is drawn once.
#pragma once

#include <vtkOpenGLFramebufferObject.h>
#include <vtkOpenGLRenderWindow.h>
#include <vtkSmartPointer.h>

namespace palpate::view {

/// A part of a window, from its lower left corner [pixels].
struct Area {
  int left = 0;
  int low = 0;
  int right = 0;  ///< Behind its last pixel; not more than `left`: there is none.
  int high = 0;

  [[nodiscard]] bool empty() const noexcept { return right <= left || high <= low; }
  /// The smallest that has both.
  [[nodiscard]] Area with(const Area& other) const noexcept;
};

/// Colours and depths of a window, as they were at some time.
class KeptImage {
 public:
  /// Takes what the window has rendered last.
  void take(vtkOpenGLRenderWindow& window);
  /// Puts a part back where the window renders: between the start of a frame and what is drawn on
  /// it. Does nothing where there is none, or the window has another size.
  void putBack(vtkOpenGLRenderWindow& window, const Area& part) const;
  /// Frees what the graphics hold.
  void release(vtkOpenGLRenderWindow& window);

 private:
  vtkSmartPointer<vtkOpenGLFramebufferObject> image_;
  int size_[2] = {0, 0};
};

}  // namespace palpate::view
