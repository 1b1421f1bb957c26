#include "palpate/scenes/apps/view/window.h"

#include <algorithm>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <map>
#include <unistd.h>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <vtkActor.h>
#include <vtkCallbackCommand.h>
#include <vtkCamera.h>
#include <vtkCellArray.h>
#include <vtkCommand.h>
#include <vtkOpenGLState.h>
#include <vtkPNGWriter.h>
#include <vtkPolyDataMapper.h>
#include <vtkProperty.h>
#include <vtkTextProperty.h>
#include <vtkUnsignedCharArray.h>
#include <vtkWindowToImageFilter.h>
#include <vtk_glew.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/common/common.h"
#include "palpate/scenes/apps/view/sampled.h"

namespace palpate::view {
namespace {

constexpr int kFrame = 33;            // [ms]
constexpr int kSparingFrame = 100;    // [ms], while the loop is late
constexpr double kPanelEvery = 0.12;  // [s]
constexpr double kSpan = 2.0;         // length of the strips [s]
constexpr double kStalled = 0.5;      // [s] without a tick
constexpr double kSettled = 0.25;     // rest of the camera before the backdrop is refined [s]
constexpr double kMoving = 0.2;       // [s] between two backdrops of a scene that moves
constexpr double kNowhere = 1e9;      // [m]
constexpr double kGhost = 0.35;
constexpr float kDial = 1.25F;

double secondsSince(std::chrono::steady_clock::time_point since) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - since).count();
}

double cpu() {
  timespec now{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

const char* const kHelp =
    "mouse: the hand    wheel: nearer, farther\n"
    "left button: turn    middle: shift    right: zoom\n"
    "1-9, up, down: choose a mode    o: off, on    + -: strength\n"
    "Esc: force off    Enter: on again\n"
    "s: slices through the proxy    r, v: camera\n"
    "space: record (not yet)    ?: keys    q: close";

template <class Call>
void observe(vtkObject& of, unsigned long event, Call call) {
  auto command = vtkSmartPointer<vtkCallbackCommand>::New();
  auto* kept = new Call(std::move(call));
  command->SetClientData(kept);
  command->SetClientDataDeleteCallback([](void* data) { delete static_cast<Call*>(data); });
  command->SetCallback(
      [](vtkObject*, unsigned long, void* data, void*) { (*static_cast<Call*>(data))(); });
  of.AddObserver(event, command);
}

}  // namespace

/// Passes on the user's input.
class ViewWindow::Events {
 public:
  explicit Events(ViewWindow& window) {
    vtkRenderWindowInteractor& from = *window.interactor_;
    observe(from, vtkCommand::TimerEvent, [&window] { window.frame(); });
    observe(from, vtkCommand::KeyPressEvent, [&window, &from] {
      const char* name = from.GetKeySym();
      if (name != nullptr) window.key(name);
    });
    observe(from, vtkCommand::MouseMoveEvent, [&window, &from] {
      const int* at = from.GetEventPosition();
      window.move(at[0], at[1]);
    });
    const std::map<unsigned long, int> presses{{vtkCommand::LeftButtonPressEvent, 1},
                                               {vtkCommand::MiddleButtonPressEvent, 2},
                                               {vtkCommand::RightButtonPressEvent, 3}};
    for (const auto& [event, button] : presses) {
      observe(from, event, [&window, &from, button = button] {
        window.turning_ = button;
        window.last_ = {from.GetEventPosition()[0], from.GetEventPosition()[1]};
      });
    }
    for (const auto event :
         {vtkCommand::LeftButtonReleaseEvent, vtkCommand::MiddleButtonReleaseEvent,
          vtkCommand::RightButtonReleaseEvent}) {
      observe(from, event, [&window] { window.turning_ = 0; });
    }
    observe(from, vtkCommand::MouseWheelForwardEvent, [&window] { window.wheel(1.0); });
    observe(from, vtkCommand::MouseWheelBackwardEvent, [&window] { window.wheel(-1.0); });
    observe(from, vtkCommand::ConfigureEvent, [&window] { window.layOut(); });
    observe(from, vtkCommand::ExitEvent, [&window] { window.key("q"); });
  }
};

ViewWindow::ViewWindow(LiveBlock& block, std::unique_ptr<Shapes> shapes, const std::string& title,
                       const Options& options)
    : block_(block),
      shapes_(std::move(shapes)),
      options_(options),
      window_(vtkSmartPointer<vtkOpenGLRenderWindow>::Take(
          vtkOpenGLRenderWindow::SafeDownCast(vtkRenderWindow::New()))),
      scene_(vtkSmartPointer<vtkRenderer>::New()),
      through_(vtkSmartPointer<vtkRenderer>::New()),
      restored_(vtkSmartPointer<vtkRenderer>::New()),
      hidden_(vtkSmartPointer<vtkRenderer>::New()),
      side_(vtkSmartPointer<vtkRenderer>::New()) {
  const int width = options.width * options.magnify;
  const int height = options.height * options.magnify;
  window_->SetOffScreenRendering(options.offscreen ? 1 : 0);
  window_->SetSize(width, height);
  window_->SetWindowName(title.c_str());
  window_->SetMultiSamples(options.offscreen ? 8 : 0);
  window_->SetNumberOfLayers(5);
  for (auto& renderer : {scene_, through_, restored_, hidden_}) {
    renderer->SetActiveCamera(scene_->GetActiveCamera());
    renderer->SetInteractive(0);
    window_->AddRenderer(renderer);
  }
  scene_->SetBackground(0.13, 0.15, 0.18);
  scene_->SetBackground2(0.24, 0.27, 0.31);
  scene_->GradientBackgroundOn();
  int layer = 0;
  for (auto& renderer : {through_, restored_, hidden_}) {
    renderer->SetLayer(++layer);
    renderer->SetPreserveDepthBuffer(1);
  }
  side_->SetLayer(++layer);
  side_->SetInteractive(0);
  window_->AddRenderer(side_);
  layOut();

  panel_.emplace(*side_, options.magnify);
  newtons_ = vtkSmartPointer<vtkTextActor>::New();
  newtons_->GetTextProperty()->SetFontSize(15 * options.magnify);
  newtons_->GetTextProperty()->SetBold(1);
  newtons_->GetTextProperty()->SetColor(kForce[0], kForce[1], kForce[2]);
  newtons_->GetTextProperty()->SetShadow(1);
  help_ = vtkSmartPointer<vtkTextActor>::New();
  help_->SetInput(kHelp);
  help_->SetPosition(14.0, 14.0);
  help_->GetTextProperty()->SetFontSize(13);
  help_->GetTextProperty()->SetColor(0.92, 0.92, 0.92);
  help_->GetTextProperty()->SetShadow(1);
  help_->VisibilityOff();
  furnish();

  // Hidden parts pass the depth test where parts in front of them were drawn before.
  observe(*hidden_, vtkCommand::StartEvent,
          [this] { window_->GetState()->vtkglDepthFunc(GL_GREATER); });
  observe(*hidden_, vtkCommand::EndEvent,
          [this] { window_->GetState()->vtkglDepthFunc(GL_LEQUAL); });
  if (!options.offscreen) {
    observe(*restored_, vtkCommand::StartEvent, [this] {
      const Area now = drawnOver();
      backdrop_.putBack(*window_, over_backdrop_.with(now));
      over_backdrop_ = now;
    });
  }
  resetCamera();
}

void ViewWindow::furnish() {
  for (auto& renderer : {scene_, through_, restored_, hidden_}) renderer->RemoveAllViewProps();
  const double size = std::max(1e-6, shapes_->bounds().size().maxCoeff());
  shapes_->addTo(*scene_, *through_);
  overlay_.emplace(*restored_, size, 1.0);
  ghost_.emplace(*hidden_, size, kGhost);
  slices_.emplace(*scene_);
  stream_ = vtkSmartPointer<vtkPolyData>::New();
  auto mapper = vtkSmartPointer<vtkPolyDataMapper>::New();
  mapper->SetInputData(stream_);
  auto actor = vtkSmartPointer<vtkActor>::New();
  actor->SetMapper(mapper);
  actor->GetProperty()->SetColor(1.0, 1.0, 1.0);
  actor->GetProperty()->SetLineWidth(static_cast<float>(3 * options_.magnify));
  actor->GetProperty()->LightingOff();
  restored_->AddActor(actor);
  hidden_->AddActor2D(newtons_);
  hidden_->AddActor2D(help_);
  sliced_.reset();
  stale_ = true;
}

void ViewWindow::follow(const LiveScene& modes) {
  ++changes_;
  // Keeps the wishes for modes that were known; takes the loop's dials for the others.
  const LiveWishes wished = wishes_;
  wishes_.dial_count =
      static_cast<std::uint32_t>(std::min<std::size_t>(modes.mode_count, kLiveModes));
  for (std::size_t i = 0; i < wishes_.dial_count; ++i) {
    wishes_.dials[i] = modes.modes[i].dial;
    const LiveDial* const end = wished.dials.data() + wished.dial_count;
    const LiveDial* const wish = std::find_if(wished.dials.data(), end, [&](const LiveDial& dial) {
      return dial.mode == wishes_.dials[i].mode;
    });
    if (wish != end) wishes_.dials[i] = *wish;
  }
  if (modes_.id == 0 && wishes_.dial_count > 0) selected_ = wishes_.dials[0].mode;
  modes_ = modes;
  again_ = static_cast<bool>(options_.again);
}

void ViewWindow::takeAgain() {
  if (again_ && !reading_.valid()) {
    again_ = false;
    reading_ = options_.again();
    ++changes_;
  }
  if (!reading_.valid() || reading_.wait_for(std::chrono::seconds(0)) != std::future_status::ready)
    return;
  ++changes_;
  try {
    auto shapes = reading_.get();
    const Box before = shapes_->bounds();
    shapes_ = std::move(shapes);
    furnish();
    if (before.lower != shapes_->bounds().lower || before.upper != shapes_->bounds().upper) {
      resetCamera();
    }
  } catch (const Error& e) {
    message_ = e.what();
    message_until_ = Clock::now() + std::chrono::seconds(10);
  }
}

void ViewWindow::slice() {
  const auto& volumes = shapes_->volumes();
  std::size_t next = sliced_ ? *sliced_ + 1 : 0;
  while (next < volumes.size() && volumes[next].field.index() != 0) ++next;
  if (next >= volumes.size()) {
    if (!sliced_) {
      message_ = "there is no scalar volume to slice";
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
      slices_->show(*std::get<0>(volumes[i].field), pose, proxy, grey_.first, grey_.second);
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

ViewWindow::~ViewWindow() {
  backdrop_.release(*window_);
}

void ViewWindow::resetCamera() {
  const Box& box = shapes_->bounds();
  const Vec3 centre = box.centre();
  const double size = std::max(1e-6, box.size().norm());
  vtkCamera& camera = *scene_->GetActiveCamera();
  // From the front, a little from the side and above; z is up.
  const Vec3 from = centre + 1.65 * size * Vec3(0.35, -0.87, 0.35);
  camera.SetFocalPoint(centre.x(), centre.y(), centre.z());
  camera.SetPosition(from.x(), from.y(), from.z());
  camera.SetViewUp(0.0, 0.0, 1.0);
  constexpr double kAngle = 32.0;
  camera.SetViewAngle(kAngle);
  clip();
  stale_ = true;
}

void ViewWindow::layOut() {
  const int* size = window_->GetSize();
  if (laid_out_[0] == size[0] && laid_out_[1] == size[1]) return;
  laid_out_ = {size[0], size[1]};
  const double panel = std::min(0.9, 1.0 * Panel::kWidth * options_.magnify / std::max(1, size[0]));
  for (auto& renderer : {scene_, through_, restored_, hidden_}) {
    renderer->SetViewport(0.0, 0.0, 1.0 - panel, 1.0);
  }
  side_->SetViewport(1.0 - panel, 0.0, 1.0, 1.0);
  stale_ = true;
  ++changes_;
  panel_at_ = {};
}

void ViewWindow::refresh() {
  over_ = over_ || block_.over.load() != 0;
  LiveTick tick;
  bool fresh = false;
  // A writer in the middle of a tick has finished by the next try.
  for (int i = 0; i < 3 && !fresh; ++i) fresh = block_.tick.read(tick);
  if (fresh && tick.tick != tick_.tick) {
    tick_ = tick;
    tick_at_ = Clock::now();
    ++changes_;
  }
  LiveScene modes;
  if (block_.scene.read(modes) && modes.id != modes_.id) follow(modes);
  withdraw();
  const std::int64_t newest = block_.newest.load(std::memory_order_acquire);
  const std::int64_t oldest = newest - static_cast<std::int64_t>(kLiveRows) + 64;
  std::int64_t next = rows_.empty() ? oldest : rows_.back().tick + 1;
  for (next = std::max({next, oldest, std::int64_t{1}}); next <= newest; ++next) {
    LiveRow row;
    if (block_.rows[static_cast<std::size_t>(next) % kLiveRows].read(row) && row.tick == next) {
      rows_.push_back(row);
    }
  }
  if (!rows_.empty()) {
    const double since = rows_.back().time - kSpan;
    rows_.erase(rows_.begin(), std::find_if(rows_.begin(), rows_.end(),
                                            [&](const LiveRow& row) { return row.time >= since; }));
  }
  // The loop's process is the parent of this one; an orphan gets another parent.
  gone_ = gone_ || block_.process.load() != getppid();
  const bool stalled = gone_ || (tick_.tick > 0 && secondsSince(tick_at_) > kStalled);
  if (stalled != stalled_) ++changes_;
  stalled_ = stalled;
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
  // Faint parts are at the same places as visible ones.
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
  // VTK cuts off parts that are nearer to the camera than a thousandth of the farthest depth.
  constexpr double kReach = 20.0;  // in sizes of the scene
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
    // Makes the bounds half as large again, so that not every step outwards costs a backdrop.
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
  // The window must not show the backdrop without the hand.
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
  // The next backdrop must be in time.
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
    newtons_->SetPosition(at[0] + 8.0, at[1] + 6.0);
  }
  // Parts that are not drawn stay in the window.
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
  if (reading_.valid()) notes.emplace_back("the scene is being read anew");
  if (detail_ >= Shapes::kCoarsest) {
    notes.emplace_back("drawn coarsely, to be in time");
  } else if (detail_ > 1) {
    notes.push_back(fmt::format("drawn coarser, to be in time: {0} x {0} pixels", detail_));
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
    content.legend.insert(
        content.legend.begin(),
        {"slices of " + shapes_->volumes()[*sliced_].name, {}, grey_.first, grey_.second, true});
  }
  content.status = statusOf(tick_, options_.reengage);
  if (stalled_ && !over_) {
    content.status = {"THE LOOP HAS STOPPED", gone_
                                                  ? "its program has ended: see its terminal"
                                                  : "no tick for half a second: see its terminal"};
  }
  if (over_) content.status = {"the run is over"};
  content.notes = notes();
  if (content.notes.empty() && !options_.offscreen) content.notes = {"?: keys"};
  panel_->show(content, static_cast<double>(window_->GetSize()[1]) / options_.magnify);
  panel_at_ = Clock::now();
  panel_fresh_ = true;
  panelled_ = changes_;
}

void ViewWindow::frame() {
  const double before = cpu();
  const std::int64_t late = tick_.late_ticks;
  refresh();
  layOut();
  if (over_ && !options_.offscreen) {
    interactor_->TerminateApp();
    return;
  }
  takeAgain();
  if (!hand_known_ && tick_.tick > 0) {
    hand_ = {tick_.probe[0], tick_.probe[1], tick_.probe[2]};
    hand_known_ = true;
  }
  if (!message_.empty() && Clock::now() >= message_until_) {
    message_.clear();
    ++changes_;
  }
  // The loop comes first: fewer frames while it is late.
  const bool sparing = tick_.late_ticks > late;
  if (sparing) rest_since_ = Clock::now();
  // Skips a frame that is not visible, or that is shown already.
  if (!sight_->now()) return;
  const bool moves = shapes_->moves() && !stalled_;
  stale_ = stale_ || (moves && secondsSince(rest_since_) > kMoving);
  const bool due = changes_ != panelled_ && secondsSince(panel_at_) > kPanelEvery;
  const bool refine =
      drawn_ > detail_ && !moves && turning_ == 0 && secondsSince(rest_since_) > kSettled;
  if (changes_ == framed_ && !due && !stale_ && !refine) return;
  showHand();
  const vtkBoundingBox hand = this->hand();
  stale_ = stale_ || (hand.IsValid() && !clipped_.Contains(hand));
  const double before_backdrop = cpu();
  if (due) drawSlices();
  if (stale_) {
    drawBackdrop(Shapes::kCoarsest);
    rest_since_ = Clock::now();
  } else if (refine) {
    drawBackdrop(detail_);
  }
  const double backdrop = cpu() - before_backdrop;
  if (due) fillPanel();
  drawFrame();
  if (frames_ == 1 && options_.shown) options_.shown();
  const double cost = cpu() - before - backdrop;
  if (frame_costs_.size() < kCosts) frame_costs_.resize(frame_costs_.size() + 1);
  frame_costs_[next_cost_++ % kCosts] = cost;
  if (sparing) {
    const timespec pause{0, (kSparingFrame - kFrame) * 1000000L};
    nanosleep(&pause, nullptr);
  }
}

void ViewWindow::wish() {
  block_.wishes.write(wishes_);
}

void ViewWindow::withdraw() {
  const std::uint64_t refused = block_.refused.load();
  if (refused == refused_) return;
  refused_ = refused;
  // Newer requests are answered later.
  if (refused < wishes_.dialled) return;
  for (std::size_t i = 0; i < wishes_.dial_count; ++i) wishes_.dials[i] = modes_.modes[i].dial;
  ++changes_;
  message_ = "that cannot be felt: see the loop's terminal";
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
    // Switches the mode off, or on again with its last factor.
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
    message_ = "recording is not in this version";
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
    // Moves the hand on its plane parallel to the screen.
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
  constexpr double kTurn = 0.4;  // degrees per pixel
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

Told ViewWindow::told() const {
  Told told;
  const auto vector = [](const std::array<double, 3>& a) {
    return cli::toJson(Vec3(a[0], a[1], a[2]));
  };
  told["tick"] = tick_.tick;
  told["time"] = tick_.time;
  told["probe"] = vector(tick_.probe);
  told["proxy"] = vector(tick_.proxy);
  told["force"] = vector(tick_.force);
  const auto pixel = [&](const Vec3& p) {
    const auto at = onScreen(p);
    return Told{at[0], at[1]};
  };
  told["hand"] = cli::toJson(hand_);
  told["size"] = {window_->GetSize()[0], window_->GetSize()[1]};
  told["pixels"]["probe"] = pixel({tick_.probe[0], tick_.probe[1], tick_.probe[2]});
  told["pixels"]["proxy"] = pixel({tick_.proxy[0], tick_.proxy[1], tick_.proxy[2]});
  told["pixels"]["tip"] = pixel(overlay_->tip());
  told["pixels"]["centre"] = pixel(shapes_->bounds().centre());
  told["bars"] = Told::array();
  for (const Bar& bar : bars_) {
    told["bars"].push_back({{"name", bar.name},
                            {"load", bar.load},
                            {"strength", bar.strength},
                            {"state", cli::wordFor(bar.hold)},
                            {"dial", bar.felt.factor},
                            {"words", wordsOf(bar)}});
  }
  told["status"] = statusOf(tick_, options_.reengage);
  told["stalled"] = stalled_;
  told["late_ticks"] = tick_.late_ticks;
  told["rows"] = rows_.size();
  told["frames"] = frames_;
  told["frames_reading"] = frames_reading_;
  told["coarse"] = drawn_ > detail_;
  told["detail"] = drawn_;
  // Costs of the last frames.
  std::vector<double> costs = frame_costs_;
  std::sort(costs.begin(), costs.end());
  const auto of = [&costs](double share) {
    if (costs.empty()) return 0.0;
    return 1e3 * costs[static_cast<std::size_t>(share * static_cast<double>(costs.size() - 1))];
  };
  told["frame_cpu_ms"] = {{"p50", of(0.5)}, {"p90", of(0.9)}, {"p99", of(0.99)}};
  for (const auto& [name, cost] :
       {std::pair{"coarse_ms", coarse_cost_}, std::pair{"refined_ms", refined_cost_}}) {
    told[name] = {{"cpu", 1e3 * cost.cpu}, {"wall", 1e3 * cost.wall}};
  }
  told["sliced"] = sliced_ ? shapes_->volumes()[*sliced_].name : "";
  told["legend"] = Told::array();
  for (const auto& entry : shapes_->legend()) told["legend"].push_back(entry.name);
  told["notes"] = notes();
  return told;
}

void ViewWindow::draw(const std::string& file) {
  refresh();
  stalled_ = false;
  over_ = false;
  drawSlices();
  shapes_->detail(1);
  if (shapes_->moves()) shapes_->moveTo(tick_.time);
  showHand();
  clip();
  help_->VisibilityOff();
  fillPanel();
  drawFrame();
  write(file, false);
}

void ViewWindow::write(const std::string& picture, bool rendered) {
  auto image = vtkSmartPointer<vtkWindowToImageFilter>::New();
  image->SetInput(window_);
  image->ReadFrontBufferOff();
  image->SetShouldRerender(rendered ? 0 : 1);
  auto writer = vtkSmartPointer<vtkPNGWriter>::New();
  writer->SetInputConnection(image->GetOutputPort());
  writer->WriteToMemoryOn();
  writer->Write();
  vtkUnsignedCharArray* bytes = writer->GetResult();
  const auto* all = reinterpret_cast<const char*>(bytes->GetPointer(0));
  // For print: pHYs with 11811 pixels per metre, which is 300 dpi, after the header, with its
  // checksum.
  constexpr std::streamsize kHeader = 33;
  constexpr unsigned char kPrint[] = {0,    0, 0, 9,    'p',  'H', 'Y',  's',  0,    0,   0x2e,
                                      0x23, 0, 0, 0x2e, 0x23, 1,   0x78, 0xa5, 0x3f, 0x76};
  std::ofstream file(picture, std::ios::binary);
  file.write(all, kHeader);
  file.write(reinterpret_cast<const char*>(kPrint), sizeof kPrint);
  file.write(all + kHeader, bytes->GetNumberOfValues() - kHeader);
  file.close();
  if (!file) {
    throw Error(picture, "it cannot be written", "check the place and the disk");
  }
}

void ViewWindow::tell(const std::string& shot, const std::string& told_file) {
  // Renames a complete file: a reader never finds a part.
  if (!shot.empty()) {
    write(shot + ".partial", true);
    std::filesystem::rename(shot + ".partial", shot);
  }
  const std::string partial = told_file + ".partial";
  std::ofstream(partial) << told().dump(2) << "\n";
  std::filesystem::rename(partial, told_file);
}

void ViewWindow::run(double every, const std::string& shot, const std::string& told_file) {
  interactor_ = vtkSmartPointer<vtkRenderWindowInteractor>::New();
  interactor_->SetInteractorStyle(nullptr);
  interactor_->SetRenderWindow(window_);
  events_ = std::make_unique<Events>(*this);
  interactor_->Initialize();
  sight_.emplace(reinterpret_cast<std::uintptr_t>(window_->GetGenericWindowId()));
  interactor_->CreateRepeatingTimer(kFrame);
  if (!told_file.empty()) {
    observe(*interactor_, vtkCommand::TimerEvent,
            [this, every, shot, told_file, last = Clock::now()]() mutable {
              if (secondsSince(last) < every || frames_ == 0) return;
              tell(shot, told_file);
              last = Clock::now();
            });
  }
  interactor_->Start();
}

}  // namespace palpate::view
