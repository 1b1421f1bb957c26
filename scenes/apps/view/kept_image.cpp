#include "palpate/scenes/apps/view/kept_image.h"

#include <algorithm>

#include <vtkOpenGLState.h>
#include <vtk_glew.h>

namespace palpate::view {
namespace {

/// Copies a part of the read framebuffer to the draw framebuffer, without the scissor test.
void copy(vtkOpenGLState& state, const Area& part) {
  const vtkOpenGLState::ScopedglEnableDisable scissor(&state, GL_SCISSOR_TEST);
  state.vtkglDisable(GL_SCISSOR_TEST);
  glBlitFramebuffer(part.left, part.low, part.right, part.high, part.left, part.low, part.right,
                    part.high, GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT, GL_NEAREST);
}

}  // namespace

Area Area::with(const Area& other) const noexcept {
  if (other.empty()) return *this;
  if (empty()) return other;
  return {std::min(left, other.left), std::min(low, other.low), std::max(right, other.right),
          std::max(high, other.high)};
}

void KeptImage::take(vtkOpenGLRenderWindow& window) {
  vtkOpenGLState* state = window.GetState();
  const int* size = window.GetSize();
  state->PushFramebufferBindings();
  if (image_ == nullptr || size_[0] != size[0] || size_[1] != size[1]) {
    image_ = vtkSmartPointer<vtkOpenGLFramebufferObject>::New();
    image_->SetContext(&window);
    // OpenGL copies only between framebuffers with the same depth format.
    window.GetRenderFramebuffer()->Bind(GL_READ_FRAMEBUFFER);
    GLint bits = 0;
    glGetFramebufferAttachmentParameteriv(GL_READ_FRAMEBUFFER, GL_DEPTH_ATTACHMENT,
                                          GL_FRAMEBUFFER_ATTACHMENT_DEPTH_SIZE, &bits);
    image_->PopulateFramebuffer(size[0], size[1], true, 1, VTK_UNSIGNED_CHAR, true, bits, 0);
    size_[0] = size[0];
    size_[1] = size[1];
  }
  window.GetRenderFramebuffer()->Bind(GL_READ_FRAMEBUFFER);
  image_->Bind(GL_DRAW_FRAMEBUFFER);
  copy(*state, {0, 0, size_[0], size_[1]});
  state->PopFramebufferBindings();
}

void KeptImage::putBack(vtkOpenGLRenderWindow& window, const Area& part) const {
  const int* size = window.GetSize();
  if (image_ == nullptr || size_[0] != size[0] || size_[1] != size[1]) return;
  const Area whole{std::max(0, part.left), std::max(0, part.low), std::min(size_[0], part.right),
                   std::min(size_[1], part.high)};
  if (whole.empty()) return;
  vtkOpenGLState* state = window.GetState();
  state->PushFramebufferBindings();
  image_->Bind(GL_READ_FRAMEBUFFER);
  window.GetRenderFramebuffer()->Bind(GL_DRAW_FRAMEBUFFER);
  copy(*state, whole);
  state->PopFramebufferBindings();
}

void KeptImage::release(vtkOpenGLRenderWindow& window) {
  if (image_ != nullptr) image_->ReleaseGraphicsResources(&window);
  image_ = nullptr;
}

}  // namespace palpate::view
