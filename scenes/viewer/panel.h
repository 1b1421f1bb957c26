/// What a tick's numbers say, beside the picture: what each mode bears of what it can, the last two
/// seconds, and in words how the loop is.
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

#include "palpate/scenes/cli/touch.h"
#include "palpate/scenes/live.h"
#include "palpate/scenes/viewer/shapes.h"

namespace palpate::view {

/// One mode, as the panel shows it.
struct Bar {
  std::string name;
  double load = 0.0;      ///< What it does to the proxy [N].
  double strength = 0.0;  ///< What it can at most [N].
  cli::Hold hold = cli::Hold::kIdle;
  bool slips = false;  ///< Its friction does.
  LiveDial felt;       ///< What the loop balances.
  float wish = 1.0F;   ///< The factor that its user has asked for.
};
/// The modes of a tick, in the scene's order.
[[nodiscard]] std::vector<Bar> barsOf(const LiveTick& tick, const LiveScene& scene,
                                      const LiveWishes& wishes);

/// What a bar says: what is felt, and a wish that is not yet.
[[nodiscard]] std::string wordsOf(const Bar& bar);

/// How the loop is, with the cause and what to do about it, a line each.
[[nodiscard]] std::vector<std::string> statusOf(const LiveTick& tick);

/// A panel of fixed width at the right of a window.
class Panel {
 public:
  static constexpr int kWidth = 300;            ///< [pixels]
  static constexpr std::size_t kMostBars = 12;  ///< Modes that are shown.

  /// `scale`: pixels of the picture for one of the panel's.
  Panel(vtkRenderer& renderer, double scale);

  /// What is to be seen, some ten times a second.
  struct Content {
    std::vector<Bar> bars;
    std::optional<std::uint32_t> selected;  ///< The mode that keys turn.
    std::vector<LiveRow> rows;              ///< The last two seconds, ascending.
    std::vector<std::string> status;        ///< Lines.
    std::vector<std::string> notes;         ///< Lines, small.
    std::vector<Shapes::Entry> legend;
  };
  /// `height`: of the panel [pixels].
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
  Drawing lines_;  ///< In front of them.
  std::vector<vtkSmartPointer<vtkTextActor>> texts_;
  std::size_t used_ = 0;  ///< Texts of this drawing.
};

}  // namespace palpate::view
