/// The window. It draws the backdrop when it changes, and the hand and the panel in every frame. It
/// also takes the user's requests.
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

/// Data of the last drawing, for tests. Positions are in pixels from the window's lower left
/// corner.
using Told = nlohmann::ordered_json;

/// Shows the state of a running loop until the window is closed.
class ViewWindow {
 public:
  struct Options {
    int width = 960;        ///< Width of the window [pixels].
    int height = 640;       ///< Height of the window [pixels].
    double reengage = 0.0;  ///< LoopParams::reengage of the loop [s].
    bool offscreen = false;
    /// Number of pixels of the picture for one pixel of the window, in each direction.
    int magnify = 1;
    /// Longest time that drawing a refined backdrop may take [s]. If it takes longer, the next one
    /// is coarser.
    double patience = 0.75;
    /// Called when the loop has a new scene. The future gets the shapes once they are read, or an
    /// Error. Returns an invalid future if the scene file has not changed.
    std::function<std::future<std::unique_ptr<Shapes>>()> again;
    std::function<void()> shown;  ///< Called once the first frame is shown.
  };
  ViewWindow(LiveBlock& block, std::unique_ptr<Shapes> shapes, const std::string& title,
             const Options& options);
  ~ViewWindow();
  ViewWindow(const ViewWindow&) = delete;
  ViewWindow& operator=(const ViewWindow&) = delete;

  /// Runs until the window is closed or the run has ended. Every `every` seconds, writes the data
  /// of the drawing to the file `told` and a picture of the window to the file `shot`. A file with
  /// an empty name is not written.
  void run(double every, const std::string& shot, const std::string& told);
  /// Draws the newest tick once and writes the picture as a PNG file.
  void draw(const std::string& file);
  /// Returns the data of the last drawing.
  [[nodiscard]] Told told() const;

 private:
  using Clock = std::chrono::steady_clock;
  class Events;

  void frame();
  void refresh();    ///< Reads the newest data from the loop.
  void takeAgain();  ///< Starts to read a changed scene, or shows it once it is read.
  void showHand();
  /// Returns the bounds of the drawn hand. The bounds end where a wider range would make the depths
  /// too inaccurate.
  [[nodiscard]] vtkBoundingBox hand() const;
  void clip();  ///< Sets the depth range of the camera so that it covers all shapes and the hand.
  void drawBackdrop(int detail);
  void drawFrame();
  void fillPanel();
  /// Returns the notes for the panel: about the picture, or a message.
  [[nodiscard]] std::vector<std::string> notes() const;
  void layOut();   ///< Divides the window into picture and panel.
  void furnish();  ///< Adds all shapes to their renderers.
  /// Shows the modes of the loop's new scene; keeps the requested gains of modes that both scenes
  /// have.
  void follow(const LiveScene& modes);
  void drawSlices();  ///< Draws slices and streamlines through the proxy.
  void slice();       ///< Selects the next volume for the slices; clears them after the last one.
  void wish();        ///< Sends the user's requests to the loop.
  void write(const std::string& picture, bool rendered);
  void tell(const std::string& shot, const std::string& told_file);
  [[nodiscard]] std::array<double, 2> onScreen(const Vec3& p) const;
  [[nodiscard]] Area drawnOver() const;  ///< Returns the area that the hand covers now.

  // User input.
  void key(const std::string& name);
  void move(int x, int y);
  void wheel(double steps);
  void resetCamera();
  /// Selects the mode with this index in bars_, which the keys then change.
  void choose(std::size_t bar);
  /// Returns the index of the selected mode in bars_; if no mode is selected, the number of bars.
  [[nodiscard]] std::size_t chosen() const;
  /// Multiplies the gain of the selected mode. With 0, switches the mode off, or on again.
  void dial(float factor);
  void withdraw();  ///< Resets requested gains that the loop has rejected.

  LiveBlock& block_;
  bool again_ = false;  ///< True if the scene file must be checked for a change.
  /// The thread that reads a changed scene; the destructor waits for it.
  std::future<std::unique_ptr<Shapes>> reading_;
  std::unique_ptr<Shapes> shapes_;
  Options options_;
  vtkSmartPointer<vtkOpenGLRenderWindow> window_;
  vtkSmartPointer<vtkRenderer> scene_;    ///< Draws the backdrop.
  vtkSmartPointer<vtkRenderer> through_;  ///< Draws translucent shapes.
  /// Draws the stored backdrop and the visible parts of the hand.
  vtkSmartPointer<vtkRenderer> restored_;
  vtkSmartPointer<vtkRenderer> hidden_;  ///< Draws the hidden parts of the hand faintly.
  vtkSmartPointer<vtkRenderer> side_;    ///< Draws the panel.
  vtkSmartPointer<vtkRenderWindowInteractor> interactor_;
  std::unique_ptr<Events> events_;
  std::optional<Sight> sight_;
  std::optional<Overlay> overlay_;
  std::optional<Overlay> ghost_;
  std::optional<Panel> panel_;
  std::optional<Slices> slices_;
  vtkSmartPointer<vtkPolyData> stream_;  ///< Streamlines through the proxy.
  std::optional<std::size_t> sliced_;    ///< Index in Shapes::volumes() of the volume with slices.
  std::pair<double, double> grey_;       ///< Values that are black and white in the slices.
  /// Point in which the slices meet, and where streamlines start [m].
  Vec3 sliced_at_ = Vec3::Zero();
  vtkSmartPointer<vtkTextActor> newtons_;
  vtkSmartPointer<vtkTextActor> help_;
  KeptImage backdrop_;

  LiveTick tick_;
  LiveScene modes_;
  LiveWishes wishes_;  ///< Requests of the user. The gains are in the order of the modes in modes_.
  /// Gains that modes had before they were switched off.
  std::map<std::uint32_t, float> before_off_;
  std::uint64_t refused_ = 0;  ///< Last value of LiveBlock::refused that was read.
  std::array<int, 2> laid_out_{};
  std::vector<LiveRow> rows_;
  std::vector<Bar> bars_;
  std::optional<std::uint32_t> selected_;  ///< LiveDial::mode of the mode that the keys change.
  Vec3 hand_ = Vec3::Zero();               ///< Target of the hand that the mouse leads [m].
  bool hand_known_ = false;
  bool over_ = false;
  bool stalled_ = false;
  bool gone_ = false;              ///< True if the process of the loop has ended.
  int detail_ = 1;                 ///< Detail of a refined backdrop, as for Shapes::detail().
  int drawn_ = Shapes::kCoarsest;  ///< Detail of the backdrop in the window.
  bool stale_ = true;              ///< True if the backdrop must be drawn.
  vtkBoundingBox clipped_;         ///< Bounds that the depth range of the backdrop covers.
  std::uint64_t changes_ = 1;      ///< Number of changes of the content.
  std::uint64_t framed_ = 0;       ///< Value of changes_ that the last frame shows.
  std::uint64_t panelled_ = 0;     ///< Value of changes_ that the panel shows.
  bool panel_fresh_ = true;        ///< True if the panel must be drawn.
  Area over_backdrop_;             ///< Area of the backdrop that the last frame has drawn over.
  /// Mouse button that is held: 1 turns the camera, 2 shifts it, 3 zooms; 0: none.
  int turning_ = 0;
  std::array<int, 2> last_{};
  std::string message_;  ///< Message that the panel shows for a short time.
  Clock::time_point message_until_;
  Clock::time_point rest_since_;
  Clock::time_point panel_at_;
  Clock::time_point tick_at_;
  static constexpr std::size_t kCosts = 256;
  std::size_t next_cost_ = 0;
  std::vector<double> frame_costs_;  ///< CPU time of each of the last frames [s].
  /// Time for drawing a backdrop [s].
  struct Cost {
    double cpu = 0.0;
    double wall = 0.0;
  };
  Cost coarse_cost_;
  Cost refined_cost_;
  std::int64_t frames_ = 0;
  /// Number of frames that were drawn while a changed scene was read.
  std::int64_t frames_reading_ = 0;
};

}  // namespace palpate::view
