/// Draws three planes through a point, parallel to the sides of a volume, with grey values of a
/// scalar field.
#pragma once

#include <array>

#include <vtkActor.h>
#include <vtkImageData.h>
#include <vtkPlaneSource.h>
#include <vtkRenderer.h>
#include <vtkSmartPointer.h>

#include "palpate/engine/field/field.h"
#include "palpate/engine/field/placement.h"

namespace palpate::view {

/// Draws three slices, or hides them.
class Slices {
 public:
  explicit Slices(vtkRenderer& renderer);

  /// Draws slices of a field with the pose `pose` through the point `at` [m]. The value `low` is
  /// black and `high` is white. Takes a few milliseconds.
  void show(const ScalarField& field, const Pose& pose, const Vec3& at, double low, double high);
  void hide();

 private:
  struct Slice {
    vtkSmartPointer<vtkPlaneSource> plane;
    vtkSmartPointer<vtkImageData> image;
    vtkSmartPointer<vtkActor> actor;
  };
  std::array<Slice, 3> slices_;
};

}  // namespace palpate::view
