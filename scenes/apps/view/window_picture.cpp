#include <algorithm>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <vtkCamera.h>
#include <vtkCellArray.h>
#include <vtkCoordinate.h>
#include <vtkMatrix4x4.h>
#include <vtkTextProperty.h>

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
                    shapes_->levels(), tick_.time);
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
  Vec3 to_camera = 0.35 * right + 0.87 * front + 0.35 * Vec3::UnitZ();
  Vec3 up = Vec3::UnitZ();
  constexpr std::array<const char*, 6> kSides{"left", "right", "back", "front", "bottom", "top"};
  for (int side = 0; side < 6; ++side) {
    if (options_.camera != kSides[static_cast<std::size_t>(side)]) continue;
    const Mat3& sides = shapes_->sides();
    const double sign = side % 2 == 0 ? -1.0 : 1.0;
    to_camera = sign * sides.col(side / 2);
    // From the top, the front is at the lower edge of the picture; from the bottom, at the upper.
    up = side / 2 == 2 ? Vec3(-sign * sides.col(1)) : Vec3(sides.col(2));
  }
  const Vec3 from = centre + 1.75 * size * to_camera;
  camera.SetFocalPoint(centre.x(), centre.y(), centre.z());
  camera.SetPosition(from.x(), from.y(), from.z());
  camera.SetViewUp(up.x(), up.y(), up.z());
  constexpr double kAngle = 32.0;
  camera.SetViewAngle(kAngle);
  clip();
  stale_ = true;
}

void ViewWindow::addLetters() {
  letters_.clear();
  for (const Shapes::Letter& letter : shapes_->letters()) {
    auto text = vtkSmartPointer<vtkTextActor>::New();
    text->SetInput((" " + letter.letter + " ").c_str());
    text->GetPositionCoordinate()->SetCoordinateSystemToWorld();
    text->SetPosition(0.0, 0.0);
    text->GetPositionCoordinate()->SetValue(letter.at.x(), letter.at.y(), letter.at.z());
    vtkTextProperty& look = *text->GetTextProperty();
    look.SetFontSize(16 * options_.magnify);
    look.SetBold(1);
    look.SetColor(0.92, 0.92, 0.92);
    look.SetBackgroundColor(kDark.data());
    look.SetBackgroundOpacity(0.8);
    look.SetJustificationToCentered();
    look.SetVerticalJustificationToCentered();
    // This renderer draws its texts above all surfaces.
    through_->AddActor2D(text);
    letters_.push_back(text);
  }
}

void ViewWindow::showLetters() {
  // Two letters along the view would cover each other in the middle of the picture.
  constexpr double kAlong = 0.95;
  const Vec3 view(scene_->GetActiveCamera()->GetDirectionOfProjection());
  for (std::size_t i = 0; i < letters_.size(); ++i) {
    const Vec3 out = shapes_->letters()[i].at - shapes_->bounds().centre();
    letters_[i]->SetVisibility(std::abs(view.dot(out)) < kAlong * out.norm());
  }
}

double ViewWindow::shownShare(const Vec3& from, const Vec3& to) const {
  constexpr double kFrame = 0.9;    // of the picture's width and height
  constexpr double kNearest = 0.5;  // of the start's distance to the camera
  const double* view = scene_->GetViewport();
  const int* size = window_->GetSize();
  const double aspect = (view[2] - view[0]) * size[0] / std::max(1.0, 1.0 * size[1]);
  const vtkMatrix4x4& matrix =
      *scene_->GetActiveCamera()->GetCompositeProjectionTransformMatrix(aspect, -1.0, 1.0);
  const auto projected = [&matrix](const Vec3& p) {
    Eigen::Vector4d out;
    for (int i = 0; i < 4; ++i) {
      out[i] = matrix.GetElement(i, 0) * p.x() + matrix.GetElement(i, 1) * p.y() +
               matrix.GetElement(i, 2) * p.z() + matrix.GetElement(i, 3);
    }
    return out;
  };
  const Eigen::Vector4d a = projected(from);
  const Eigen::Vector4d b = projected(to);
  // Each margin is positive inside the picture, and linear along the line.
  double share = 1.0;
  const auto limit = [&share](double at_start, double at_end) {
    if (at_start > 0.0 && at_end < 0.0) share = std::min(share, at_start / (at_start - at_end));
  };
  for (const int axis : {0, 1}) {
    for (const double sign : {-1.0, 1.0}) {
      limit(kFrame * a[3] + sign * a[axis], kFrame * b[3] + sign * b[axis]);
    }
  }
  limit((1.0 - kNearest) * a[3], b[3] - kNearest * a[3]);
  return share;
}

Area ViewWindow::areaOf(vtkTextActor& text) const {
  double size[2];  // NOLINT(modernize-avoid-c-arrays): VTK takes a C array
  text.GetSize(hidden_, size);
  const int margin = text.GetTextProperty()->GetFontSize() / 2;
  const double* at = text.GetPosition();
  return {static_cast<int>(at[0]) - margin, static_cast<int>(at[1]) - margin,
          static_cast<int>(at[0] + size[0]) + margin, static_cast<int>(at[1] + size[1]) + margin};
}

void ViewWindow::placeNewtons() {
  newtons_->SetPosition(0.0, 0.0);
  const Area area = areaOf(*newtons_);
  const Eigen::Vector2d half(0.5 * (area.right - area.left), 0.5 * (area.high - area.low));
  const Eigen::Vector2d corner = Eigen::Vector2d(area.left, area.low);
  const auto at = [this](const Vec3& p) { return Eigen::Vector2d(onScreen(p).data()); };
  const Vec3 proxy(tick_.proxy[0], tick_.proxy[1], tick_.proxy[2]);
  const Eigen::Vector2d tip = at(overlay_->tip());
  const Vec3 up(scene_->GetActiveCamera()->GetViewUp());
  const double radius = (at(overlay_->tip() + overlay_->headRadius() * up) - tip).norm();
  const Eigen::Vector2d arrow = tip - at(proxy);
  Eigen::Vector2d aside(1.0, 0.0);
  if (arrow.norm() > 1.0) aside = Eigen::Vector2d(arrow.y(), -arrow.x()).normalized();
  const int* size = window_->GetSize();
  const Eigen::Vector2d most(size[0] * hidden_->GetViewport()[2], size[1]);
  // Chooses the side of the arrow on which the label stays farther from it, inside the picture.
  double farthest = -1.0;
  Eigen::Vector2d best = tip;
  for (const double sign : {1.0, -1.0}) {
    const Eigen::Vector2d out = sign * aside;
    const double apart = half.dot(out.cwiseAbs()) + radius;
    const Eigen::Vector2d middle = (tip + apart * out).cwiseMin(most - half).cwiseMax(half);
    const double distance = std::min(apart, (middle - tip).dot(out));
    if (distance <= farthest + 1.0) continue;
    farthest = distance;
    best = middle;
  }
  const Eigen::Vector2d position = best - half - corner;
  newtons_->SetPosition(position.x(), position.y());
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
  if (newtons_->GetVisibility() != 0) area = areaOf(*newtons_);
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
  const auto fit = [this](const Vec3& from, const Vec3& to) { return shownShare(from, to); };
  overlay_->show(tick_, fit);
  ghost_->show(tick_, fit);
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
  showLetters();
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
  const bool felt = force.norm() > 0.005;
  newtons_->SetVisibility(felt);
  if (felt) {
    newtons_->SetInput(fmt::format("{:.2f} N{}", force.norm(),
                                   overlay_->forceShortened() ? " (arrow shortened)" : "")
                           .c_str());
    placeNewtons();
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
  if (overlay_->othersShortened()) {
    notes.emplace_back("the arrow of a directed force is shortened, to fit the picture");
  }
  if (detail_ >= Shapes::kCoarsest) {
    notes.emplace_back("reduced detail, to draw the picture in time");
  } else if (detail_ > 1) {
    notes.push_back(fmt::format("reduced detail: one ray for {0} x {0} pixels", detail_));
  }
  return notes;
}

std::vector<Shapes::Entry> ViewWindow::legend() const {
  std::vector<Shapes::Entry> legend = shapes_->legend();
  if (!sliced_) return legend;
  // Slices replace surfaces and clouds. Surfaces remain, as lines.
  const Shapes::Volume& volume = shapes_->volumes()[*sliced_];
  for (const Shapes::Level& level : shapes_->levels()) {
    for (Shapes::Entry& entry : legend) {
      if (entry.name != level.name || entry.high > entry.low) continue;
      entry.colour = level.colour;
      entry.body = false;
    }
  }
  std::erase_if(legend, [](const Shapes::Entry& entry) { return entry.body; });
  legend.insert(legend.begin(), {"slices of " + volume.name, {}, grey_.first, grey_.second, true});
  return legend;
}

void ViewWindow::fillPanel() {
  Panel::Content content;
  bars_ = barsOf(tick_, modes_, wishes_);
  content.bars = bars_;
  content.selected = selected_;
  content.rows = rows_;
  content.legend = legend();
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
