/// The window: draws the backdrop when it changes, and the hand in every frame.
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

/// Data of the last drawing, for tests. Positions in pixels are from the lower left corner.
using Told = nlohmann::ordered_json;

class ViewWindow {
 public:
  struct Options {
    int width = 960;        ///< Width of the window [pixels].
    int height = 640;       ///< Height of the window [pixels].
    double reengage = 0.0;  ///< LoopParams::reengage of the loop [s].
    bool offscreen = false;
    int magnify = 1;  ///< Pixels of the picture for each pixel of the window.
    /// Side of the camera: front, back, left, right, top or bottom. Empty: right of the front.
    std::string camera;
    std::string slice;  ///< Planes of the slices in draw(): x, y, z or all. Empty: no slices.
    /// Longest time to draw a refined backdrop [s]. If it takes longer, the next one is coarser.
    double patience = 0.75;
    /// Called when the loop has a new scene. The future is invalid if the file is unchanged.
    std::function<std::future<std::unique_ptr<Shapes>>()> again;
    std::function<void()> shown;  ///< Called once the first frame is shown.
  };
  ViewWindow(LiveBlock& block, std::unique_ptr<Shapes> shapes, const std::string& title,
             const Options& options);
  ~ViewWindow();
  ViewWindow(const ViewWindow&) = delete;
  ViewWindow& operator=(const ViewWindow&) = delete;

  /// Runs until the window is closed or the run has ended. Every `every` seconds, writes data to
  /// the file `told` and a picture to the file `shot`; an empty name means no file. Without `told`,
  /// writes no pictures either.
  void run(double every, const std::string& shot, const std::string& told);
  void draw(const std::string& file);
  [[nodiscard]] Told told() const;

 private:
  using Clock = std::chrono::steady_clock;
  class Events;

  void frame();
  void refresh();
  void takeAgain();  ///< Starts to read a changed scene, or shows the scene that was read.
  void showHand();
  /// Returns the bounds of the drawn hand, limited so that depths remain accurate.
  [[nodiscard]] vtkBoundingBox hand() const;
  void clip();
  void drawBackdrop(int detail);
  void drawFrame();
  void fillPanel();
  [[nodiscard]] std::vector<std::string> notes() const;
  /// Returns the entries of the objects that are drawn.
  [[nodiscard]] std::vector<Shapes::Entry> legend() const;
  void layOut();
  void fitToScreen();  ///< Shrinks the window to the screen, before it is shown.
  void furnish();
  /// Shows the modes of a new scene. Modes that are in both scenes keep requested gains.
  void follow(const LiveScene& modes);
  void drawSlices();  ///< Draws slices and streamlines at the proxy.
  void slice();       ///< Selects the next volume for the slices; clears them after the last one.
  void wish();
  void write(const std::string& picture, bool rendered);
  void tell(const std::string& shot, const std::string& told_file);
  [[nodiscard]] std::array<double, 2> onScreen(const Vec3& p) const;
  /// Returns the share of the line from `from` to `to` [m] that the picture shows.
  [[nodiscard]] double shownShare(const Vec3& from, const Vec3& to) const;
  void placeNewtons();  ///< Places the label of the force beside its arrow.
  /// Returns the area of a text, with a margin for its shadow and the parts below its line.
  [[nodiscard]] Area areaOf(vtkTextActor& text) const;
  void addLetters();
  void showLetters();
  [[nodiscard]] Area drawnOver() const;  ///< Returns the area that the hand covers.

  void key(const std::string& name);
  void move(int x, int y);
  void wheel(double steps);
  void resetCamera();
  void choose(std::size_t bar);
  /// Returns the index of the selected mode's bar; without one, the number of bars.
  [[nodiscard]] std::size_t chosen() const;
  /// Multiplies the gain of the selected mode. A factor of 0 switches the mode off, or on again.
  void dial(float factor);
  void withdraw();  ///< Resets requested gains that the loop has rejected.

  LiveBlock& block_;
  bool again_ = false;  ///< True if the scene file may have changed and must be checked.
  /// A changed scene that is being read; the destructor waits for it.
  std::future<std::unique_ptr<Shapes>> reading_;
  std::unique_ptr<Shapes> shapes_;
  Options options_;
  vtkSmartPointer<vtkOpenGLRenderWindow> window_;
  vtkSmartPointer<vtkRenderer> scene_;
  vtkSmartPointer<vtkRenderer> through_;   ///< Draws translucent shapes.
  vtkSmartPointer<vtkRenderer> restored_;  ///< Draws the stored backdrop and the hand.
  vtkSmartPointer<vtkRenderer> hidden_;    ///< Draws the hidden parts of the hand faintly.
  vtkSmartPointer<vtkRenderer> side_;
  vtkSmartPointer<vtkRenderWindowInteractor> interactor_;
  std::unique_ptr<Events> events_;
  std::optional<Sight> sight_;
  std::optional<Overlay> overlay_;
  std::optional<Overlay> ghost_;
  std::optional<Panel> panel_;
  std::optional<Slices> slices_;
  vtkSmartPointer<vtkPolyData> stream_;  ///< Streamlines through the proxy.
  std::optional<std::size_t> sliced_;    ///< Index in Shapes::volumes().
  std::pair<double, double> grey_;
  Vec3 sliced_at_ = Vec3::Zero();  ///< Proxy when slices and streamlines were last drawn [m].
  vtkSmartPointer<vtkTextActor> newtons_;
  vtkSmartPointer<vtkTextActor> help_;
  std::vector<vtkSmartPointer<vtkTextActor>> letters_;  ///< In the order of Shapes::letters().
  KeptImage backdrop_;

  LiveTick tick_;
  LiveScene modes_;
  LiveWishes wishes_;                          ///< The gains are in the order of modes_.
  std::map<std::uint32_t, float> before_off_;  ///< Gains before modes were switched off.
  std::uint64_t refused_ = 0;                  ///< Last value of LiveBlock::refused that was read.
  std::array<int, 2> laid_out_{};
  std::vector<LiveRow> rows_;
  std::vector<Bar> bars_;
  std::optional<std::uint32_t> selected_;  ///< LiveDial::mode of the mode that the keys change.
  Vec3 hand_ = Vec3::Zero();               ///< Target of the hand that the mouse leads [m].
  bool hand_known_ = false;
  bool over_ = false;
  bool stalled_ = false;
  bool gone_ = false;
  int detail_ = 1;                 ///< Argument of Shapes::detail().
  int drawn_ = Shapes::kCoarsest;  ///< Detail of the backdrop in the window.
  bool stale_ = true;
  vtkBoundingBox clipped_;  ///< Bounds that the depth range of the backdrop covers.
  std::uint64_t changes_ = 1;
  std::uint64_t framed_ = 0;    ///< Value of changes_ that the last frame shows.
  std::uint64_t panelled_ = 0;  ///< Value of changes_ that the panel shows.
  bool panel_fresh_ = true;
  Area over_backdrop_;  ///< Part of the backdrop that the last frame has overwritten.
  int turning_ = 0;     ///< Held mouse button: 1 turns, 2 shifts, 3 zooms; 0: none.
  std::array<int, 2> last_{};
  std::string message_;
  Clock::time_point message_until_;
  Clock::time_point rest_since_;
  Clock::time_point panel_at_;
  Clock::time_point tick_at_;
  static constexpr std::size_t kCosts = 256;
  std::size_t next_cost_ = 0;
  std::vector<double> frame_costs_;  ///< CPU times of the last frames, without the backdrop [s].
  struct Cost {
    double cpu = 0.0;
    double wall = 0.0;
  };
  Cost coarse_cost_;
  Cost refined_cost_;
  std::int64_t frames_ = 0;
  std::int64_t frames_reading_ = 0;  ///< Frames that were drawn while a changed scene was read.
};

}  // namespace palpate::view
