/// The window. Draws the backdrop when it changes, the hand in front of it in every frame and the
/// panel beside it, and takes the user's requests.
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

#include "palpate/scenes/apps/view/display.h"
#include "palpate/scenes/apps/view/kept_image.h"
#include "palpate/scenes/apps/view/overlay.h"
#include "palpate/scenes/apps/view/panel.h"
#include "palpate/scenes/apps/view/shapes.h"
#include "palpate/scenes/apps/view/slices.h"
#include "palpate/scenes/library/live.h"

namespace palpate::view {

/// Data of the last drawing, for tests: in pixels from the window's lower left corner, and in
/// numbers.
using Told = nlohmann::ordered_json;

/// Shows a running loop until it is closed.
class ViewWindow {
 public:
  struct Options {
    int width = 960;        ///< [pixels]
    int height = 640;       ///< [pixels]
    double reengage = 0.0;  ///< LoopParams::reengage of the loop [s].
    bool offscreen = false;
    int magnify = 1;         ///< Factor of a picture's pixels each way.
    double patience = 0.75;  ///< Longest time for a refined backdrop; after that it is coarser [s].
    /// Called when the loop has a new scene. Returns the shapes once they are read, or Error; an
    /// invalid future if the scene's file is unchanged.
    std::function<std::future<std::unique_ptr<Shapes>>()> again;
    std::function<void()> shown;  ///< Called after the first frame.
  };
  ViewWindow(LiveBlock& block, std::unique_ptr<Shapes> shapes, const std::string& title,
             const Options& options);
  ~ViewWindow();
  ViewWindow(const ViewWindow&) = delete;
  ViewWindow& operator=(const ViewWindow&) = delete;

  /// Runs until the window is closed or the run has ended. Every `every` seconds [s], writes the
  /// data of the drawing to the file `told`, and a picture of the window to `shot`. An empty name
  /// disables its file.
  void run(double every, const std::string& shot, const std::string& told);
  /// Draws the newest tick once, and writes it as a PNG.
  void draw(const std::string& file);
  /// Returns the data of the last drawing.
  [[nodiscard]] Told told() const;

 private:
  using Clock = std::chrono::steady_clock;
  class Events;

  void frame();
  void refresh();    ///< Reads new data of the loop.
  void takeAgain();  ///< Starts to read a changed scene; shows it once it is read.
  void showHand();
  /// Returns the bounds of the hand as shown, as far from the scene as depths reach.
  [[nodiscard]] vtkBoundingBox hand() const;
  void clip();  ///< Sets the depth range to cover all drawn objects.
  void drawBackdrop(int detail);
  void drawFrame();
  void fillPanel();
  [[nodiscard]] std::vector<std::string> notes() const;  ///< Notes on the picture, or a message.
  void layOut();                        ///< Lays out panel and picture by the window's size.
  void furnish();                       ///< Puts all shapes into their layers.
  void follow(const LiveScene& modes);  ///< Takes a new scene of the loop.
  void drawSlices();                    ///< Draws slices and streamlines through the proxy.
  void slice();                         ///< Selects the next volume for slices, or no volume.
  void wish();                          ///< Sends the wishes to the loop.
  void write(const std::string& picture, bool rendered);
  void tell(const std::string& shot, const std::string& told_file);
  [[nodiscard]] std::array<double, 2> onScreen(const Vec3& p) const;
  [[nodiscard]] Area drawnOver() const;  ///< The area of the hand as shown now.

  // User input.
  void key(const std::string& name);
  void move(int x, int y);
  void wheel(double steps);
  void resetCamera();
  void choose(std::size_t bar);              ///< Selects the mode that keys change.
  [[nodiscard]] std::size_t chosen() const;  ///< Its bar; no mode: one after the last.
  void dial(float factor);                   ///< Multiplies its strength; 0: off, or on again.
  void withdraw();                           ///< Withdraws wishes that the loop has refused.

  LiveBlock& block_;
  bool again_ = false;  ///< The scene's file must be checked for a change.
  std::future<std::unique_ptr<Shapes>> reading_;  ///< Outlives the window; its destructor waits.
  std::unique_ptr<Shapes> shapes_;
  Options options_;
  vtkSmartPointer<vtkOpenGLRenderWindow> window_;
  vtkSmartPointer<vtkRenderer> scene_;     ///< The backdrop.
  vtkSmartPointer<vtkRenderer> through_;   ///< Translucent shapes.
  vtkSmartPointer<vtkRenderer> restored_;  ///< The restored backdrop and the visible hand.
  vtkSmartPointer<vtkRenderer> hidden_;    ///< Hidden parts of the hand, faintly.
  vtkSmartPointer<vtkRenderer> side_;      ///< The panel.
  vtkSmartPointer<vtkRenderWindowInteractor> interactor_;
  std::unique_ptr<Events> events_;
  std::optional<Sight> sight_;
  std::optional<Overlay> overlay_;
  std::optional<Overlay> ghost_;
  std::optional<Panel> panel_;
  std::optional<Slices> slices_;
  vtkSmartPointer<vtkPolyData> stream_;  ///< Streamlines through the proxy.
  std::optional<std::size_t> sliced_;    ///< Index in Shapes::volumes.
  std::pair<double, double> grey_;       ///< Values of black and white in slices.
  Vec3 sliced_at_ = Vec3::Zero();        ///< Place that slices and streamlines go through [m].
  vtkSmartPointer<vtkTextActor> newtons_;
  vtkSmartPointer<vtkTextActor> help_;
  KeptImage backdrop_;

  LiveTick tick_;
  LiveScene modes_;
  LiveWishes wishes_;                          ///< Dials of the modes in modes_, in the same order.
  std::map<std::uint32_t, float> before_off_;  ///< Factors of modes that are off.
  std::uint64_t refused_ = 0;                  ///< LiveBlock::refused, as last seen.
  std::array<int, 2> laid_out_{};
  std::vector<LiveRow> rows_;
  std::vector<Bar> bars_;
  std::optional<std::uint32_t> selected_;  ///< The mode that keys change.
  Vec3 hand_ = Vec3::Zero();               ///< Place of the hand by the mouse [m].
  bool hand_known_ = false;
  bool over_ = false;
  bool stalled_ = false;
  bool gone_ = false;              ///< The loop's program has ended.
  int detail_ = 1;                 ///< Detail of a refined backdrop, as Shapes::detail.
  int drawn_ = Shapes::kCoarsest;  ///< Detail of the visible backdrop.
  bool stale_ = true;              ///< The backdrop must be drawn.
  vtkBoundingBox clipped_;         ///< Bounds that its depth range covers.
  std::uint64_t changes_ = 1;      ///< Counts changes of the content.
  std::uint64_t framed_ = 0;       ///< Value of changes_ in the last frame.
  std::uint64_t panelled_ = 0;     ///< Value of changes_ in the panel.
  bool panel_fresh_ = true;        ///< The panel must be drawn.
  Area over_backdrop_;             ///< Area that the last frame drew over.
  int turning_ = 0;                ///< Button that is held: 1 turns, 2 shifts, 3 zooms.
  std::array<int, 2> last_{};
  std::string message_;  ///< Shown for a while in the panel.
  Clock::time_point message_until_;
  Clock::time_point rest_since_;
  Clock::time_point panel_at_;
  Clock::time_point tick_at_;
  static constexpr std::size_t kCosts = 256;
  std::size_t next_cost_ = 0;
  std::vector<double> frame_costs_;  ///< CPU time of the last frames [s].
  /// Cost of a backdrop [s].
  struct Cost {
    double cpu = 0.0;
    double wall = 0.0;
  };
  Cost coarse_cost_;
  Cost refined_cost_;
  std::int64_t frames_ = 0;
  std::int64_t frames_reading_ = 0;  ///< Frames while a scene was read again.
};

}  // namespace palpate::view
