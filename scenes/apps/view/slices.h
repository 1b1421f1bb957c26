/// Draws a field's grey values and surfaces on three planes through a point, parallel to a volume's
/// sides.
#pragma once

#include <array>
#include <string>
#include <vector>

#include <vtkActor.h>
#include <vtkImageData.h>
#include <vtkPlaneSource.h>
#include <vtkRenderer.h>
#include <vtkSmartPointer.h>

#include "palpate/engine/field/field.h"
#include "palpate/engine/field/placement.h"
#include "palpate/scenes/apps/view/shapes.h"

namespace palpate::view {

class Slices {
 public:
  /// @param planes  "x", "y" or "z" for the plane perpendicular to this axis; otherwise all three.
  Slices(vtkRenderer& renderer, const std::string& planes);

  /// Draws a field in `pose` on planes through `at` [m], or through the nearest point in the
  /// field's bounds. The value `low` is black, and `high` is white. At most 16 levels are lines,
  /// first those of this field: the others where their volumes are at `time` [s].
  void show(const ScalarField& field, const Pose& pose, const Vec3& at, double low, double high,
            const std::vector<Shapes::Level>& levels, double time);
  void hide();

 private:
  struct Slice {
    vtkSmartPointer<vtkPlaneSource> plane;
    vtkSmartPointer<vtkImageData> image;
    vtkSmartPointer<vtkActor> actor;
  };
  std::array<Slice, 3> slices_;
  int only_ = -1;  ///< Axis of the only plane; negative: all planes.
};

}  // namespace palpate::view
