/// Draws the panel beside the picture: load and strength of each mode, plots, and the state of the
/// loop.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <vtkActor2D.h>
#include <vtkCellArray.h>
#include <vtkPoints.h>
#include <vtkPolyData.h>
#include <vtkRenderer.h>
#include <vtkSmartPointer.h>
#include <vtkTextActor.h>
#include <vtkUnsignedCharArray.h>

#include "palpate/scenes/apps/common/touch.h"
#include "palpate/scenes/apps/view/shapes.h"
#include "palpate/scenes/library/live.h"

namespace palpate::view {

struct Bar {
  std::string name;
  double load = 0.0;      ///< [N]
  double strength = 0.0;  ///< Strength: the largest possible load [N].
  cli::Hold hold = cli::Hold::kIdle;
  bool slips = false;  ///< True if the friction of the mode slips.
  LiveDial felt;       ///< Gain that the loop uses.
  float wish = 1.0F;   ///< Gain that the user has requested.
};
/// Returns the data of the modes of a tick, in the order of the scene. If the tick has another
/// scene, the loads are zero.
[[nodiscard]] std::vector<Bar> barsOf(const LiveTick& tick, const LiveScene& scene,
                                      const LiveWishes& wishes);

/// Returns the text for a mode: its name, its state, the requested gain unless it is 1, and a note
/// until the loop uses this gain.
[[nodiscard]] std::string wordsOf(const Bar& bar);

/// Returns the state of the loop, its cause and a remedy. `reengage` is LoopParams::reengage [s].
[[nodiscard]] std::vector<std::string> statusOf(const LiveTick& tick, double reengage);

class Panel {
 public:
  static constexpr int kWidth = 300;  ///< Width of the panel [pixels].
  static constexpr std::size_t kMostBars = 12;

  /// `scale` is the number of picture pixels for each pixel of the panel.
  Panel(vtkRenderer& renderer, double scale);

  struct Content {
    std::vector<Bar> bars;
    std::optional<std::uint32_t> selected;  ///< LiveDial::mode of the mode that the keys change.
    std::vector<LiveRow> rows;              ///< Last two seconds, in ascending order.
    std::vector<std::string> status;
    std::vector<std::string> notes;  ///< Shown in a small font.
    std::vector<Shapes::Entry> legend;
  };
  /// `height` is in pixels of the panel.
  void show(const Content& content, double height);

 private:
  void quad(double x0, double y0, double x1, double y1, const Colour& colour);
  void line(const std::vector<std::array<double, 2>>& points, const Colour& colour);
  void text(double x, double y, const std::string& words, int size, const Colour& colour);
  double strip(double top, const std::string& title, const std::vector<LiveRow>& rows,
               float LiveRow::*value, double scale, const char* unit, const Colour& colour);

  /// Shapes of one kind, with a colour for each.
  struct Drawing {
    vtkSmartPointer<vtkPoints> points;
    vtkSmartPointer<vtkCellArray> cells;
    vtkSmartPointer<vtkUnsignedCharArray> colours;
    vtkSmartPointer<vtkPolyData> data;
  };
  [[nodiscard]] Drawing drawing() const;

  vtkRenderer& renderer_;
  double scale_;
  Drawing quads_;
  Drawing lines_;  ///< Drawn in front of quads_.
  std::vector<vtkSmartPointer<vtkTextActor>> texts_;
  std::size_t used_ = 0;
};

}  // namespace palpate::view
