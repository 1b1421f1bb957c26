/// The window: a backdrop that is drawn when it changes, the hand in front of it every frame, the
/// panel beside it, and what its user asks for.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <future>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>
#include <vtkBoundingBox.h>
#include <vtkOpenGLRenderWindow.h>
#include <vtkPolyData.h>
#include <vtkRenderWindowInteractor.h>
#include <vtkRenderer.h>
#include <vtkSmartPointer.h>
#include <vtkTextActor.h>

#include "palpate/scenes/live.h"
#include "palpate/scenes/viewer/display.h"
#include "palpate/scenes/viewer/kept_image.h"
#include "palpate/scenes/viewer/overlay.h"
#include "palpate/scenes/viewer/panel.h"
#include "palpate/scenes/viewer/shapes.h"
#include "palpate/scenes/viewer/slices.h"

namespace palpate::view {

/// What was drawn last, for tests: in pixels from the window's lower left corner, and in numbers.
using Told = nlohmann::ordered_json;

/// Shows a running loop until it is closed.
class ViewWindow {
 public:
  struct Options {
    int width = 960;   ///< [pixels]
    int height = 640;  ///< [pixels]
    bool offscreen = false;
    int magnify = 1;         ///< Of a picture: as many times as many pixels each way.
    double patience = 0.75;  ///< For a refined backdrop, else it is drawn coarser [s].
    /// With a new scene of the loop's: what there is to see then, once it is read, or Error;
    /// invalid where its file is as it was.
    std::function<std::future<std::unique_ptr<Shapes>>()> again;
    std::function<void()> shown;  ///< After the first frame.
  };
  ViewWindow(LiveBlock& block, std::unique_ptr<Shapes> shapes, const std::string& title,
             const Options& options);
  ~ViewWindow();
  ViewWindow(const ViewWindow&) = delete;
  ViewWindow& operator=(const ViewWindow&) = delete;

  /// Until it is closed, or the run is over. `told`: a file that gets what was drawn, and `shot` a
  /// picture of the window, every so many seconds; empty: none.
  void run(double every, const std::string& shot, const std::string& told);
  /// Draws the newest tick once, and writes it as a PNG.
  void draw(const std::string& file);
  /// What was drawn last.
  [[nodiscard]] Told told() const;

 private:
  using Clock = std::chrono::steady_clock;
  class Events;

  void frame();
  void refresh();    ///< Reads what is new.
  void takeAgain();  ///< Takes a scene that was read anew.
  void showHand();
  /// Of the hand as it is shown, as far from the scene as depths reach.
  [[nodiscard]] vtkBoundingBox hand() const;
  void clip();  ///< Depths that have room for what is drawn.
  void drawBackdrop(int detail);
  void drawFrame();
  void fillPanel();
  [[nodiscard]] std::vector<std::string> notes() const;  ///< What the picture is not, or a message.
  void layOut();                        ///< Panel and picture, by the window's size.
  void furnish();                       ///< Puts all that is drawn into its layers.
  void follow(const LiveScene& modes);  ///< Takes a new scene of the loop's.
  void drawSlices();                    ///< Through the proxy, and the streams through it.
  void slice();                         ///< The next volume that has slices, or none.
  void wish();                          ///< Tells the loop what is wished for.
  void write(const std::string& picture, bool rendered);
  void tell(const std::string& shot, const std::string& told_file);
  [[nodiscard]] std::array<double, 2> onScreen(const Vec3& p) const;
  [[nodiscard]] Area drawnOver() const;  ///< By the hand, as it is shown now.

  // What the user does.
  void key(const std::string& name);
  void move(int x, int y);
  void wheel(double steps);
  void resetCamera();
  void choose(std::size_t bar);              ///< The mode that keys turn.
  [[nodiscard]] std::size_t chosen() const;  ///< Its bar; none: one after the last.
  void dial(float factor);                   ///< Of its strength; 0: off, or on again.
  void withdraw();                           ///< Wishes that the loop has refused.

  LiveBlock& block_;
  bool again_ = false;                            ///< A new scene is to be looked for.
  std::future<std::unique_ptr<Shapes>> reading_;  ///< Outlives the window, and its end waits.
  std::unique_ptr<Shapes> shapes_;
  Options options_;
  vtkSmartPointer<vtkOpenGLRenderWindow> window_;
  vtkSmartPointer<vtkRenderer> scene_;     ///< The backdrop.
  vtkSmartPointer<vtkRenderer> through_;   ///< What is seen through.
  vtkSmartPointer<vtkRenderer> restored_;  ///< Puts it back, and what is seen in front of it.
  vtkSmartPointer<vtkRenderer> hidden_;    ///< What is behind it, faintly.
  vtkSmartPointer<vtkRenderer> side_;      ///< The panel.
  vtkSmartPointer<vtkRenderWindowInteractor> interactor_;
  std::unique_ptr<Events> events_;
  std::optional<Sight> sight_;
  std::optional<Overlay> overlay_;
  std::optional<Overlay> ghost_;
  std::optional<Panel> panel_;
  std::optional<Slices> slices_;
  vtkSmartPointer<vtkPolyData> stream_;  ///< Through the proxy.
  std::optional<std::size_t> sliced_;    ///< Of Shapes::volumes.
  std::pair<double, double> grey_;       ///< Values of its black and white.
  Vec3 sliced_at_ = Vec3::Zero();        ///< Where slices and streams go through [m].
  vtkSmartPointer<vtkTextActor> newtons_;
  vtkSmartPointer<vtkTextActor> help_;
  KeptImage backdrop_;

  LiveTick tick_;
  LiveScene modes_;
  LiveWishes wishes_;  ///< Its dials are of the modes of modes_, in their order.
  std::map<std::uint32_t, float> before_off_;  ///< Factors of modes that are off.
  std::uint64_t refused_ = 0;                  ///< LiveBlock::refused, as last seen.
  std::array<int, 2> laid_out_{};
  std::vector<LiveRow> rows_;
  std::vector<Bar> bars_;
  std::optional<std::uint32_t> selected_;  ///< The mode that keys turn.
  Vec3 hand_ = Vec3::Zero();               ///< Where the mouse means the hand to be [m].
  bool hand_known_ = false;
  bool over_ = false;
  bool stalled_ = false;
  bool gone_ = false;              ///< The loop's program.
  int detail_ = 1;                 ///< Of a refined backdrop, as Shapes::detail.
  int drawn_ = Shapes::kCoarsest;  ///< Of the one that is seen.
  bool stale_ = true;              ///< The backdrop is to be drawn.
  vtkBoundingBox clipped_;         ///< What its depths have room for.
  std::uint64_t changes_ = 1;      ///< Of what there is to show;
  std::uint64_t framed_ = 0;       ///< of which the last frame has so many,
  std::uint64_t panelled_ = 0;     ///< and the panel.
  bool panel_fresh_ = true;        ///< The panel is to be drawn.
  Area over_backdrop_;             ///< What the last frame was drawn over.
  int turning_ = 0;                ///< Button that is held: 1 turns, 2 shifts, 3 nears.
  std::array<int, 2> last_{};
  std::string message_;  ///< For a while, in the panel.
  Clock::time_point message_until_;
  Clock::time_point rest_since_;
  Clock::time_point panel_at_;
  Clock::time_point tick_at_;
  static constexpr std::size_t kCosts = 256;
  std::size_t next_cost_ = 0;
  std::vector<double> frame_costs_;  ///< CPU of the last frames [s].
  /// Of a backdrop [s].
  struct Cost {
    double cpu = 0.0;
    double wall = 0.0;
  };
  Cost coarse_cost_;
  Cost refined_cost_;
  std::int64_t frames_ = 0;
  std::int64_t frames_reading_ = 0;  ///< Of these, while a scene was read anew.
};

}  // namespace palpate::view
