/// Removes the parts of a drawn surface or cloud that a hand cannot feel.
#pragma once

#include <string>
#include <vector>

#include <vtkImageData.h>
#include <vtkPiecewiseFunction.h>
#include <vtkPolyData.h>
#include <vtkSmartPointer.h>

#include "palpate/engine/field/field.h"
#include "palpate/engine/modes/transfer.h"

namespace palpate::view {

/// A factor of a mode's strength that another field sets, such as the mask of a body region.
struct Mask {
  const ScalarField* field;
  const TransferFunction* curve;
};

/// Returns a text that differs for different masks.
[[nodiscard]] std::string textOf(const std::vector<Mask>& masks);
/// Moves the points of a mesh that lie outside of a field's bounds to the edge of the bounds.
void moveToData(vtkPolyData& mesh, const ScalarField& field);
/// Returns the surface of `field` at the value `level` without the parts where a mask is zero or
/// has no data.
[[nodiscard]] vtkSmartPointer<vtkPolyData> feltPart(vtkPolyData& surface, const ScalarField& field,
                                                    double level, const std::vector<Mask>& masks);

/// Returns a cloud's values with a second component, their opacity: a function of the value,
/// multiplied by each mask relative to its largest output. Both are integers up to 65535.
[[nodiscard]] vtkSmartPointer<vtkImageData> feltCloud(vtkImageData& values,
                                                      vtkPiecewiseFunction& opacity,
                                                      const std::vector<Mask>& masks);

}  // namespace palpate::view
