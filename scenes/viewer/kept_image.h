/// A rendered picture, colours and depths, put back each frame: what does not change is drawn once.
#pragma once

#include <vtkOpenGLFramebufferObject.h>
#include <vtkOpenGLRenderWindow.h>
#include <vtkSmartPointer.h>

namespace palpate::view {

/// Colours and depths of a window, as they were at some time.
class KeptImage {
 public:
  /// Takes what the window has rendered last.
  void take(vtkOpenGLRenderWindow& window);
  /// Puts it back where the window renders: between the start of a frame and what is drawn on it.
  /// Does nothing where there is none, or the window has another size.
  void putBack(vtkOpenGLRenderWindow& window) const;
  /// Frees what the graphics hold.
  void release(vtkOpenGLRenderWindow& window);

 private:
  vtkSmartPointer<vtkOpenGLFramebufferObject> image_;
  int size_[2] = {0, 0};
};

}  // namespace palpate::view
