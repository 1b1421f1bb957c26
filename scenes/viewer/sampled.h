/// Fields as VTK draws them: read on an even lattice.
#pragma once

#include <vtkImageData.h>
#include <vtkSmartPointer.h>

#include "palpate/engine/field.h"

namespace palpate::view {

/// Values of a scalar field over its bounds, at rest; `most` points along the longest side. The
/// image is in W [m], its scalars are named "value". Slow, on all cores.
[[nodiscard]] vtkSmartPointer<vtkImageData> sampled(const ScalarField& field, int most);
/// Vectors, named "vector", zero where there are no data, and their magnitudes, as "value".
[[nodiscard]] vtkSmartPointer<vtkImageData> sampled(const VectorField& field, int most);

}  // namespace palpate::view
