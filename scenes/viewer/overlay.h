/// What changes every frame: probe, proxy, spring, force, and what each primitive is and does.
#pragma once

#include <array>
#include <vector>

#include <vtkActor.h>
#include <vtkLineSource.h>
#include <vtkPolyDataAlgorithm.h>
#include <vtkRenderer.h>
#include <vtkSmartPointer.h>

#include "palpate/scenes/cli/touch.h"
#include "palpate/scenes/live.h"
#include "palpate/scenes/viewer/shapes.h"

namespace palpate::view {

/// What is drawn in which colour: by what it does.
[[nodiscard]] Colour colourOf(cli::Hold hold);

/// The primitive as the last balance left it: whether it holds or yields.
[[nodiscard]] cli::Load loadIn(const LiveTick& tick, const LivePrimitive& primitive);

/// Draws one tick. The same twice in a window: once where nothing hides it, and faintly where
/// something does.
class Overlay {
 public:
  /// `size`: of the scene [m], for the size of what is drawn; `opacity` 0 to 1.
  Overlay(vtkRenderer& renderer, double size, double opacity);

  /// Draws a tick. RT: not for a loop; some 0.1 ms.
  void show(const LiveTick& tick);

  /// Bounds of each thing that is seen, as VTK has them.
  [[nodiscard]] std::vector<std::array<double, 6>> seen() const;
  /// Length of the arrow for one newton [m].
  [[nodiscard]] double metresPerNewton() const noexcept { return 0.1 * size_; }
  /// Tip of the force's arrow, as drawn last [m].
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
  /// One of each kind of primitive, of which one is seen.
  std::array<std::array<vtkSmartPointer<vtkActor>, 4>, kMost> primitives_;
};

}  // namespace palpate::view
