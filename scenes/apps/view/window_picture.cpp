#include <algorithm>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <vtkCamera.h>
#include <vtkCellArray.h>

#include "palpate/scenes/apps/view/sampled.h"
#include "palpate/scenes/apps/view/window.h"
#include "palpate/scenes/apps/view/window_clock.h"

namespace palpate::view {
namespace {

constexpr double kNowhere = 1e9;  // [m]

}  // namespace

void ViewWindow::slice() {
  const auto& volumes = shapes_->volumes();
  std::size_t next = sliced_ ? *sliced_ + 1 : 0;
  while (next < volumes.size() && volumes[next].field.index() != 0) ++next;
  if (next >= volumes.size()) {
    if (!sliced_) {
      message_ = "the scene has no scalar volume to slice";
      message_until_ = Clock::now() + std::chrono::seconds(3);
    }
    sliced_.reset();
    slices_->hide();
  } else {
    constexpr int kPoints = 48;
    sliced_ = next;
    grey_ = usual(*sampled(*std::get<0>(volumes[next].field), kPoints));
  }
  shapes_->showBodies(!sliced_);
  sliced_at_.setConstant(kNowhere);
  stale_ = true;
}

void ViewWindow::drawSlices() {
  const Vec3 proxy(tick_.proxy[0], tick_.proxy[1], tick_.proxy[2]);
  const double least = 0.003 * shapes_->bounds().size().maxCoeff();
  if ((proxy - sliced_at_).norm() < least) return;
  bool drawn = false;
  auto points = vtkSmartPointer<vtkPoints>::New();
  auto cells = vtkSmartPointer<vtkCellArray>::New();
  const auto& volumes = shapes_->volumes();
  for (std::size_t i = 0; i < volumes.size(); ++i) {
    const Pose pose = volumes[i].motion ? volumes[i].motion->poseAbout(proxy, tick_.time) : Pose{};
    if (sliced_ == i) {
      slices_->show(*std::get<0>(volumes[i].field), pose, proxy, grey_.first, grey_.second,
                    shapes_->levels());
      drawn = true;
    }
    const auto* flow = std::get_if<std::shared_ptr<const VectorField>>(&volumes[i].field);
    if (flow == nullptr) continue;
    const auto line = lineThrough(**flow, Along::kValue, pose.toRest(proxy),
                                  0.7 * (*flow)->frame().bounds.size().maxCoeff());
    if (line.empty()) continue;
    cells->InsertNextCell(static_cast<int>(line.size()));
    for (const Vec3& p : line) cells->InsertCellPoint(points->InsertNextPoint(pose(p).data()));
  }
  stale_ = stale_ || drawn;
  stream_->SetPoints(points);
  stream_->SetLines(cells);
  stream_->Modified();
  sliced_at_ = proxy;
}

void ViewWindow::resetCamera() {
  const Box& box = shapes_->bounds();
  const Vec3 centre = box.centre();
  const double size = std::max(1e-6, box.size().norm());
  vtkCamera& camera = *scene_->GetActiveCamera();
  // The camera is about 20 degrees right of the scene's front and above it. z points up.
  const Vec3& front = shapes_->front();
  const Vec3 right = Vec3::UnitZ().cross(front);
  const Vec3 from = centre + 1.75 * size * (0.35 * right + 0.87 * front + 0.35 * Vec3::UnitZ());
  camera.SetFocalPoint(centre.x(), centre.y(), centre.z());
  camera.SetPosition(from.x(), from.y(), from.z());
  camera.SetViewUp(0.0, 0.0, 1.0);
  constexpr double kAngle = 32.0;
  camera.SetViewAngle(kAngle);
  clip();
  stale_ = true;
}

std::array<double, 2> ViewWindow::onScreen(const Vec3& p) const {
  double shown[3];
  scene_->SetWorldPoint(p.x(), p.y(), p.z(), 1.0);
  scene_->WorldToDisplay();
  scene_->GetDisplayPoint(shown);
  return {shown[0], shown[1]};
}

Area ViewWindow::drawnOver() const {
  const int* size = window_->GetSize();
  const Area all{0, 0, static_cast<int>(size[0] * scene_->GetViewport()[2]), size[1]};
  if (help_->GetVisibility() != 0) return all;
  Area area;
  if (newtons_->GetVisibility() != 0) {
    const double* at = newtons_->GetPosition();
    constexpr int kWide = 120;
    constexpr int kHigh = 30;
    area = {static_cast<int>(at[0]) - 4, static_cast<int>(at[1]) - 10,
            static_cast<int>(at[0]) + kWide, static_cast<int>(at[1]) + kHigh};
  }
  // Both overlays, for visible and hidden parts, cover the same area, so one is enough.
  const Vec3 eye(scene_->GetActiveCamera()->GetPosition());
  const Vec3 along(scene_->GetActiveCamera()->GetDirectionOfProjection());
  auto boxes = overlay_->seen();
  if (stream_->GetNumberOfLines() > 0) {
    std::copy_n(stream_->GetBounds(), 6, boxes.emplace_back().begin());
  }
  for (const auto& box : boxes) {
    for (int corner = 0; corner < 8; ++corner) {
      const Vec3 p(box[corner & 1], box[2 + ((corner >> 1) & 1)], box[4 + ((corner >> 2) & 1)]);
      if ((p - eye).dot(along) < 1e-6) return all;
      const auto at = onScreen(p);
      constexpr double kFarthest = 1e6;
      const int x = static_cast<int>(std::clamp(at[0], -kFarthest, kFarthest));
      const int y = static_cast<int>(std::clamp(at[1], -kFarthest, kFarthest));
      area = area.with({x - 2, y - 2, x + 3, y + 3});
    }
  }
  // The panel is beside the picture.
  area.right = std::min(area.right, all.right);
  return area;
}

void ViewWindow::showHand() {
  overlay_->show(tick_);
  ghost_->show(tick_);
}

vtkBoundingBox ViewWindow::hand() const {
  vtkBoundingBox hand;
  for (const auto& box : overlay_->seen()) hand.AddBounds(box.data());
  // VTK clips parts nearer to the camera than a thousandth of the greatest depth.
  constexpr double kReach = 20.0;  // multiples of the scene's size
  const Box& scene = shapes_->bounds();
  const Vec3 reach = Vec3::Constant(kReach * std::max(1e-6, scene.size().maxCoeff()));
  const Vec3 least = scene.centre() - reach;
  const Vec3 most = scene.centre() + reach;
  const vtkBoundingBox near(least.x(), most.x(), least.y(), most.y(), least.z(), most.z());
  if (!hand.Intersects(near)) return {};
  hand.IntersectBox(near);
  return hand;
}

void ViewWindow::clip() {
  clipped_.Reset();
  double bounds[6];
  for (const auto& renderer : {scene_, through_}) {
    renderer->ComputeVisiblePropBounds(bounds);
    clipped_.AddBounds(bounds);
  }
  const vtkBoundingBox hand = this->hand();
  if (hand.IsValid() && !clipped_.Contains(hand)) {
    // With this margin, a hand that moves outwards seldom requires a new backdrop.
    clipped_.AddBox(hand);
    clipped_.ScaleAboutCenter(1.5);
  }
  if (!clipped_.IsValid()) return;
  clipped_.GetBounds(bounds);
  scene_->ResetCameraClippingRange(bounds);
}

void ViewWindow::drawBackdrop(int detail) {
  const double before = cpu();
  const auto start = Clock::now();
  shapes_->detail(detail);
  if (shapes_->moves()) shapes_->moveTo(tick_.time);
  clip();
  for (auto& renderer : {restored_, hidden_, side_}) renderer->DrawOff();
  for (auto& renderer : {scene_, through_}) renderer->DrawOn();
  // Does not show this rendering, which lacks the hand.
  window_->SetSwapBuffers(0);
  window_->Render();
  backdrop_.take(*window_);
  window_->SetSwapBuffers(1);
  for (auto& renderer : {scene_, through_}) renderer->DrawOff();
  for (auto& renderer : {restored_, hidden_}) renderer->DrawOn();
  drawn_ = detail;
  stale_ = false;
  Cost& cost = detail == Shapes::kCoarsest ? coarse_cost_ : refined_cost_;
  cost = {cpu() - before, secondsSince(start)};
  if (detail == detail_ && detail < Shapes::kCoarsest && cost.wall > options_.patience) {
    detail_ = 2 * detail;
  }
}

void ViewWindow::drawFrame() {
  const Vec3 force(tick_.force[0], tick_.force[1], tick_.force[2]);
  const auto at = onScreen(overlay_->tip());
  const bool felt = force.norm() > 0.005;
  newtons_->SetVisibility(felt);
  if (felt) {
    newtons_->SetInput(fmt::format("{:.2f} N", force.norm()).c_str());
    // Keeps the whole text in the picture, beside the panel.
    double text[2];  // NOLINT(modernize-avoid-c-arrays): VTK takes a C array
    newtons_->GetSize(hidden_, text);
    const int* size = window_->GetSize();
    const double right = size[0] * hidden_->GetViewport()[2] - text[0];
    const double top = size[1] - text[1];
    newtons_->SetPosition(std::clamp(at[0] + 8.0, 0.0, std::max(0.0, right)),
                          std::clamp(at[1] + 6.0, 0.0, std::max(0.0, top)));
  }
  // If the panel is not drawn, the window keeps the panel's previous picture.
  side_->SetDraw(panel_fresh_ ? 1 : 0);
  panel_fresh_ = false;
  window_->Render();
  framed_ = changes_;
  ++frames_;
  if (reading_.valid()) ++frames_reading_;
}

std::vector<std::string> ViewWindow::notes() const {
  if (!message_.empty()) return {message_};
  std::vector<std::string> notes = shapes_->notes();
  if (reading_.valid()) notes.emplace_back("the scene is loading again");
  if (detail_ >= Shapes::kCoarsest) {
    notes.emplace_back("reduced detail, to draw the picture in time");
  } else if (detail_ > 1) {
    notes.push_back(fmt::format("reduced detail: one ray for {0} x {0} pixels", detail_));
  }
  return notes;
}

void ViewWindow::fillPanel() {
  Panel::Content content;
  bars_ = barsOf(tick_, modes_, wishes_);
  content.bars = bars_;
  content.selected = selected_;
  content.rows = rows_;
  content.legend = shapes_->legend();
  if (sliced_) {
    const Shapes::Volume& volume = shapes_->volumes()[*sliced_];
    for (const Shapes::Level& level : shapes_->levels()) {
      if (level.field != std::get<0>(volume.field)->id()) continue;
      for (Shapes::Entry& entry : content.legend) {
        if (entry.name == level.name) entry.colour = level.colour;
      }
    }
    content.legend.insert(content.legend.begin(),
                          {"slices of " + volume.name, {}, grey_.first, grey_.second, true});
  }
  content.status = statusOf(tick_, options_.reengage);
  if (stalled_ && !over_) {
    content.status = {"THE LOOP HAS STOPPED",
                      gone_ ? "the loop's program has ended: read the terminal of palpate view"
                            : "no tick for 0.5 s: read the terminal of palpate view"};
  }
  if (over_) content.status = {"the run has ended"};
  content.notes = notes();
  if (content.notes.empty() && !options_.offscreen) content.notes = {"?: keys"};
  panel_->show(content, static_cast<double>(window_->GetSize()[1]) / options_.magnify);
  panel_at_ = Clock::now();
  panel_fresh_ = true;
  panelled_ = changes_;
}

}  // namespace palpate::view
