#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>
#include <vtkCamera.h>

#include "palpate/scenes/apps/view/window.h"

namespace palpate::view {
namespace {

constexpr float kDial = 1.25F;

}  // namespace

void ViewWindow::wish() {
  block_.wishes.write(wishes_);
}

void ViewWindow::withdraw() {
  const std::uint64_t refused = block_.refused.load();
  if (refused == refused_) return;
  refused_ = refused;
  // The loop has not yet answered the last request.
  if (refused < wishes_.dialled) return;
  for (std::size_t i = 0; i < wishes_.dial_count; ++i) wishes_.dials[i] = modes_.modes[i].dial;
  ++changes_;
  message_ = "change rejected: see the terminal for the reason";
  message_until_ = Clock::now() + std::chrono::seconds(10);
}

void ViewWindow::choose(std::size_t bar) {
  if (bar < std::min(bars_.size(), Panel::kMostBars)) selected_ = bars_[bar].felt.mode;
}

std::size_t ViewWindow::chosen() const {
  const auto bar = std::find_if(bars_.begin(), bars_.end(),
                                [this](const Bar& b) { return selected_ == b.felt.mode; });
  return static_cast<std::size_t>(bar - bars_.begin());
}

void ViewWindow::dial(float factor) {
  LiveDial* const end = wishes_.dials.data() + wishes_.dial_count;
  LiveDial* const turned = std::find_if(
      wishes_.dials.data(), end, [this](const LiveDial& dial) { return selected_ == dial.mode; });
  if (turned == end) return;
  float& dial = turned->factor;
  if (factor == 0.0F) {
    // Switches the mode off, or restores the gain from before the mode was switched off.
    const auto [before, fresh] = before_off_.try_emplace(turned->mode, 1.0F);
    if (dial != 0.0F) before->second = dial;
    dial = dial == 0.0F ? before->second : 0.0F;
  } else if (dial != 0.0F) {
    dial = std::clamp(dial * factor, 1.0F / kMostDial, kMostDial);
  }
  ++wishes_.dialled;
  wish();
}

void ViewWindow::key(const std::string& name) {
  ++changes_;
  if (name == "Escape") {
    ++wishes_.cuts;
    wish();
  } else if (name == "Return" || name == "KP_Enter") {
    ++wishes_.clears;
    wish();
  } else if (name == "q") {
    wishes_.closed = 1;
    wish();
    interactor_->TerminateApp();
  } else if (name == "r") {
    resetCamera();
  } else if (name == "v") {
    scene_->GetActiveCamera()->Azimuth(90.0);
    stale_ = true;
  } else if (name == "question") {
    help_->SetVisibility(help_->GetVisibility() == 0 ? 1 : 0);
  } else if (name == "s") {
    slice();
  } else if (name == "space") {
    message_ = "press space in the terminal to pause a sequence";
    message_until_ = Clock::now() + std::chrono::seconds(3);
  } else if (name.size() == 1 && name[0] >= '1' && name[0] <= '9') {
    choose(static_cast<std::size_t>(name[0] - '1'));
  } else if (name == "Down") {
    choose(chosen() < bars_.size() ? chosen() + 1 : 0);
  } else if (name == "Up") {
    choose(chosen() == 0 || chosen() == bars_.size() ? 0 : chosen() - 1);
  } else if (name == "o") {
    dial(0.0F);
  } else if (name == "plus" || name == "KP_Add" || name == "equal") {
    dial(kDial);
  } else if (name == "minus" || name == "KP_Subtract") {
    dial(1.0F / kDial);
  }
}

void ViewWindow::move(int x, int y) {
  const int dx = x - last_[0];
  const int dy = y - last_[1];
  last_ = {x, y};
  vtkCamera& camera = *scene_->GetActiveCamera();
  const int* size = window_->GetSize();
  if (turning_ == 0) {
    if (!hand_known_ || x > size[0] - Panel::kWidth) return;
    // Moves the hand in the plane through its position that is parallel to the screen.
    double shown[3];
    double world[4];
    scene_->SetWorldPoint(hand_.x(), hand_.y(), hand_.z(), 1.0);
    scene_->WorldToDisplay();
    scene_->GetDisplayPoint(shown);
    scene_->SetDisplayPoint(x, y, shown[2]);
    scene_->DisplayToWorld();
    scene_->GetWorldPoint(world);
    if (world[3] == 0.0) return;
    hand_ = Vec3(world[0], world[1], world[2]) / world[3];
    block_.hand.write({{hand_.x(), hand_.y(), hand_.z()}});
    return;
  }
  constexpr double kTurn = 0.4;  // [degrees per pixel]
  if (turning_ == 1) {
    camera.Azimuth(-kTurn * dx);
    camera.Elevation(std::clamp(-kTurn * dy, -5.0, 5.0));
    camera.OrthogonalizeViewUp();
  } else if (turning_ == 2) {
    const double scale =
        camera.GetDistance() * std::tan(0.5 * camera.GetViewAngle() * M_PI / 180.0) * 2.0 / size[1];
    double up[3];
    camera.GetViewUp(up);
    const Vec3 u(up);
    const Vec3 along(camera.GetDirectionOfProjection());
    const Vec3 shift = scale * (-dx * along.cross(u).normalized() - dy * u);
    const Vec3 position = Vec3(camera.GetPosition()) + shift;
    const Vec3 focus = Vec3(camera.GetFocalPoint()) + shift;
    camera.SetPosition(position.x(), position.y(), position.z());
    camera.SetFocalPoint(focus.x(), focus.y(), focus.z());
  } else {
    camera.Dolly(std::clamp(1.0 + 0.005 * dy, 0.8, 1.25));
  }
  stale_ = true;
}

void ViewWindow::wheel(double steps) {
  if (!hand_known_) return;
  const Vec3 along(scene_->GetActiveCamera()->GetDirectionOfProjection());
  hand_ += steps * 0.01 * shapes_->bounds().size().maxCoeff() * along;
  block_.hand.write({{hand_.x(), hand_.y(), hand_.z()}});
}

}  // namespace palpate::view
