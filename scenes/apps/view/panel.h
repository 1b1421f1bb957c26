/// The panel beside the picture: the load and the strength of each mode in a tick, the last two
/// seconds, and the state of the loop in words.
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

/// One mode, as the panel shows it.
struct Bar {
  std::string name;
  double load = 0.0;      ///< Force on the proxy [N].
  double strength = 0.0;  ///< Largest force [N].
  cli::Hold hold = cli::Hold::kIdle;
  bool slips = false;  ///< Its friction slips.
  LiveDial felt;       ///< Dial that the loop uses.
  float wish = 1.0F;   ///< Factor that the user has requested.
};
/// Returns the bars of a tick's modes, in the scene's order.
[[nodiscard]] std::vector<Bar> barsOf(const LiveTick& tick, const LiveScene& scene,
                                      const LiveWishes& wishes);

/// Returns the text of a bar: the present state, and a request that is not in effect yet.
[[nodiscard]] std::string wordsOf(const Bar& bar);

/// Returns the state of the loop, with cause and remedy, one line each.
///
/// @param reengage  LoopParams::reengage of the loop [s].
[[nodiscard]] std::vector<std::string> statusOf(const LiveTick& tick, double reengage);

/// A panel of fixed width at the right of a window.
class Panel {
 public:
  static constexpr int kWidth = 300;            ///< [pixels]
  static constexpr std::size_t kMostBars = 12;  ///< Modes that are shown.

  /// `scale`: pixels of the picture per pixel of the panel.
  Panel(vtkRenderer& renderer, double scale);

  /// Content of the panel, shown about ten times a second.
  struct Content {
    std::vector<Bar> bars;
    std::optional<std::uint32_t> selected;  ///< The mode that keys change.
    std::vector<LiveRow> rows;              ///< The last two seconds, ascending.
    std::vector<std::string> status;        ///< Lines.
    std::vector<std::string> notes;         ///< Lines, small.
    std::vector<Shapes::Entry> legend;
  };
  /// Draws the content. `height`: the panel's height [pixels].
  void show(const Content& content, double height);

 private:
  void quad(double x0, double y0, double x1, double y1, const Colour& colour);
  void line(const std::vector<std::array<double, 2>>& points, const Colour& colour);
  void text(double x, double y, const std::string& words, int size, const Colour& colour);
  double strip(double top, const std::string& title, const std::vector<LiveRow>& rows,
               float LiveRow::*value, double scale, const char* unit, const Colour& colour);

  /// Shapes of one kind, each with its colour.
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
  Drawing lines_;  ///< In front of quads_.
  std::vector<vtkSmartPointer<vtkTextActor>> texts_;
  std::size_t used_ = 0;  ///< Texts used by this drawing.
};

}  // namespace palpate::view
