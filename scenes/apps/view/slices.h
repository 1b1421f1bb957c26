/// Draws three planes through a place, parallel to a volume's sides, in grey: a scalar as its modes
/// read it.
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

/// Draws the three planes, or hides them.
class Slices {
 public:
  explicit Slices(vtkRenderer& renderer);

  /// Draws planes through `at` [m] of a field that is placed by `pose`; black at `low`, white at
  /// `high`. Takes some milliseconds.
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
