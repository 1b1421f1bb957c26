#include "palpate/scenes/apps/view/window.h"

#include <algorithm>
#include <ctime>
#include <map>
#include <unistd.h>

#include <vtkActor.h>
#include <vtkCallbackCommand.h>
#include <vtkCamera.h>
#include <vtkCommand.h>
#include <vtkOpenGLState.h>
#include <vtkPolyDataMapper.h>
#include <vtkProperty.h>
#include <vtkTextProperty.h>
#include <vtk_glew.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/apps/view/window_clock.h"

namespace palpate::view {
namespace {

constexpr int kFrame = 33;            // [ms]: time between two frames
constexpr int kSparingFrame = 100;    // [ms]: the same, while ticks of the loop are late
constexpr double kPanelEvery = 0.12;  // [s]: shortest time between two drawings of the panel
constexpr double kSpan = 2.0;         // [s]: time that the plots of the panel show
constexpr double kStalled = 0.5;   // [s]: without a tick for this long, the loop counts as stopped
constexpr double kSettled = 0.25;  // [s]: rest of the camera before the backdrop is refined
constexpr double kMoving = 0.2;    // [s]: shortest time between two backdrops of a moving scene
constexpr double kGhost = 0.35;

// Fits into a window of 640 by 480 pixels, beside the panel.
const char* const kHelp =
    "mouse: move the hand\n"
    "wheel: move it nearer, farther\n"
    "left, middle, right button:\n"
    "    turn, shift, zoom the camera\n"
    "1-9, up, down: choose a mode\n"
    "o: mode off, on    + -: strength\n"
    "Esc: force off    Enter: force on\n"
    "s: slices through the proxy\n"
    "r, v: reset, turn the camera\n"
    "?: keys    q: close";

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

double secondsSince(std::chrono::steady_clock::time_point since) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - since).count();
}

double cpu() {
  timespec now{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

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
  newtons_->GetTextProperty()->SetBackgroundColor(kDark.data());
  newtons_->GetTextProperty()->SetBackgroundOpacity(0.8);
  help_ = vtkSmartPointer<vtkTextActor>::New();
  help_->SetInput(kHelp);
  help_->SetPosition(14.0, 14.0);
  help_->GetTextProperty()->SetFontSize(13);
  help_->GetTextProperty()->SetColor(0.92, 0.92, 0.92);
  help_->GetTextProperty()->SetShadow(1);
  help_->VisibilityOff();
  furnish();

  // Draws the hidden parts: only pixels behind other parts of the picture.
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
  slices_.emplace(*scene_, options_.slice);
  addLetters();
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
  // Modes that the previous scene had too keep their requested gains; others get the loop's gains.
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

ViewWindow::~ViewWindow() {
  backdrop_.release(*window_);
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
  // Tries again if the loop was writing a tick.
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
  // The loop's process started this one. After the loop ends, this process has another parent.
  gone_ = gone_ || block_.process.load() != getppid();
  const bool stalled = gone_ || (tick_.tick > 0 && secondsSince(tick_at_) > kStalled);
  if (stalled != stalled_) ++changes_;
  stalled_ = stalled;
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
  // The loop has priority, so the window draws less often while ticks are late.
  const bool sparing = tick_.late_ticks > late;
  if (sparing) rest_since_ = Clock::now();
  // Draws no frame if the window is hidden or unchanged.
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

void ViewWindow::fitToScreen() {
  const int* screen = window_->GetScreenSize();
  if (screen == nullptr || screen[0] <= 0 || screen[1] <= 0) return;
  const int* size = window_->GetSize();
  // The desktop's bars and the window's title take about a tenth of the height.
  const int width = std::min(size[0], screen[0]);
  const int height = std::min(size[1], 9 * screen[1] / 10);
  window_->SetSize(width, height);
  layOut();
}

void ViewWindow::run(double every, const std::string& shot, const std::string& told_file) {
  interactor_ = vtkSmartPointer<vtkRenderWindowInteractor>::New();
  interactor_->SetInteractorStyle(nullptr);
  interactor_->SetRenderWindow(window_);
  fitToScreen();
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
