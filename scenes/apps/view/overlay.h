/// Draws the parts that change in every frame: probe, proxy, spring, force, and the kind and state
/// of each primitive.
#pragma once

#include <array>
#include <vector>

#include <vtkActor.h>
#include <vtkLineSource.h>
#include <vtkPolyDataAlgorithm.h>
#include <vtkRenderer.h>
#include <vtkSmartPointer.h>

#include "palpate/scenes/apps/common/touch.h"
#include "palpate/scenes/apps/view/shapes.h"
#include "palpate/scenes/library/live.h"

namespace palpate::view {

/// Returns the colour of a primitive's state.
[[nodiscard]] Colour colourOf(cli::Hold hold);

/// Returns the load of a primitive in the last balance: whether it holds or yields.
[[nodiscard]] cli::Load loadIn(const LiveTick& tick, const LivePrimitive& primitive);

/// Draws one tick. A window has two overlays: one for visible parts, and a faint one for hidden
/// parts.
class Overlay {
 public:
  /// `size`: size of the scene [m], which scales the drawing; `opacity` 0 to 1.
  Overlay(vtkRenderer& renderer, double size, double opacity);

  /// Draws a tick. RT: not for a loop; about 0.1 ms.
  void show(const LiveTick& tick);

  /// Returns the bounds of each visible actor, as VTK gives them.
  [[nodiscard]] std::vector<std::array<double, 6>> seen() const;
  /// Returns the arrow's length for one newton [m].
  [[nodiscard]] double metresPerNewton() const noexcept { return 0.1 * size_; }
  /// Returns the tip of the force's arrow, as drawn last [m].
  [[nodiscard]] const Vec3& tip() const noexcept { return tip_; }

 private:
  static constexpr std::size_t kMost = 24;  ///< Primitives that are drawn.

  vtkSmartPointer<vtkActor> add(vtkAlgorithmOutput* output, const Colour& colour);
  vtkRenderer& renderer_;
  std::vector<vtkSmartPointer<vtkActor>> all_;
  double size_;
  double opacity_;
  Vec3 tip_ = Vec3::Zero();
  vtkSmartPointer<vtkActor> probe_;
  vtkSmartPointer<vtkActor> proxy_;
  vtkSmartPointer<vtkActor> spring_;
  vtkSmartPointer<vtkActor> force_;
  /// Each primitive has one actor per kind, and shows the actor of its kind.
  std::array<std::array<vtkSmartPointer<vtkActor>, 4>, kMost> primitives_;
};

}  // namespace palpate::view
