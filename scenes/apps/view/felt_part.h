/// Removes the parts of a drawn surface that a hand cannot feel.
#pragma once

#include <string>
#include <vector>

#include <vtkPolyData.h>
#include <vtkSmartPointer.h>

#include "palpate/engine/field/field.h"
#include "palpate/engine/modes/transfer.h"

namespace palpate::view {

/// A factor of an isosurface's strength that another field sets, such as a patient's region.
struct Mask {
  const ScalarField* field;
  const TransferFunction* curve;
};

/// Returns a text that differs for different masks.
[[nodiscard]] std::string textOf(const std::vector<Mask>& masks);
/// Returns the surface of `field` at the value `level` without the parts where a mask is zero or
/// has no data.
[[nodiscard]] vtkSmartPointer<vtkPolyData> feltPart(vtkPolyData& surface, const ScalarField& field,
                                                    double level, const std::vector<Mask>& masks);

}  // namespace palpate::view
