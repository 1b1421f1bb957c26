/// Draws the objects that move in every frame: probe, proxy, spring, force, and primitives.
#pragma once

#include <array>
#include <functional>
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

[[nodiscard]] Colour colourOf(cli::Hold hold);

/// Returns the load of a primitive in the last balance of the tick, with its state.
[[nodiscard]] cli::Load loadIn(const LiveTick& tick, const LivePrimitive& primitive);

/// Draws one tick. A window has two overlays: one for visible parts, a faint one for hidden parts.
class Overlay {
 public:
  /// @param size     Size of the scene [m]; all shapes are drawn in proportion to it.
  /// @param opacity  Opacity, 0 to 1.
  Overlay(vtkRenderer& renderer, double size, double opacity);

  /// Returns the share of the line from one point to another [m], 0 to 1, that the picture shows.
  using Fit = std::function<double(const Vec3& from, const Vec3& to)>;
  /// Draws a tick with its first kMost primitives. Shortens each arrow to the share that `fit`
  /// returns. Updates objects of VTK, so do not call it in a haptic loop.
  void show(const LiveTick& tick, const Fit& fit);

  /// Returns the bounds of each visible actor: least and greatest x, y and z [m].
  [[nodiscard]] std::vector<std::array<double, 6>> seen() const;
  /// Returns the length of the force's arrow for a force of 1 N [m].
  [[nodiscard]] double metresPerNewton() const noexcept { return 0.1 * size_; }
  /// Returns the tip of the force's arrow in the last drawing [m].
  [[nodiscard]] const Vec3& tip() const noexcept { return tip_; }
  /// Returns the radius of this arrow's head [m].
  [[nodiscard]] double headRadius() const noexcept { return head_radius_; }
  [[nodiscard]] bool forceShortened() const noexcept { return force_shortened_; }
  /// Returns true if the arrow of a directed force was shortened in the last drawing.
  [[nodiscard]] bool othersShortened() const noexcept { return others_shortened_; }

 private:
  static constexpr std::size_t kMost = 24;

  vtkSmartPointer<vtkActor> add(vtkAlgorithmOutput* output, const Colour& colour);
  /// Shows the arrow of the vector `along` at the point `from` [m]. Returns the radius of its head
  /// [m].
  double putArrow(vtkActor& actor, const Vec3& from, const Vec3& along, double least_width);
  vtkRenderer& renderer_;
  std::vector<vtkSmartPointer<vtkActor>> all_;
  double size_;
  double opacity_;
  Vec3 tip_ = Vec3::Zero();
  double head_radius_ = 0.0;
  bool force_shortened_ = false;
  bool others_shortened_ = false;
  vtkSmartPointer<vtkActor> probe_;
  vtkSmartPointer<vtkActor> proxy_;
  vtkSmartPointer<vtkActor> spring_;
  vtkSmartPointer<vtkActor> force_;
  /// One actor for each kind of primitive. Only the actor of the primitive's kind is visible.
  std::array<std::array<vtkSmartPointer<vtkActor>, 4>, kMost> primitives_;
};

}  // namespace palpate::view
