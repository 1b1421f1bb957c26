/// Fields as VTK draws them: read on an even lattice.
#pragma once

#include <utility>

#include <vtkImageData.h>
#include <vtkSmartPointer.h>

#include "palpate/engine/field.h"
#include "palpate/scenes/viewer/streams.h"

namespace palpate::view {

/// Values of a scalar field over its bounds, at rest; `most` points along the longest side. The
/// image is in W [m], its scalars are named "value". Slow, on all cores.
[[nodiscard]] vtkSmartPointer<vtkImageData> sampled(const ScalarField& field, int most);
/// Vectors, named "vector", zero where there are no data, and their magnitudes, as "value".
[[nodiscard]] vtkSmartPointer<vtkImageData> sampled(const VectorField& field, Along along,
                                                    int most);
/// The values between which nearly all lie.
[[nodiscard]] std::pair<double, double> usual(vtkImageData& image);

}  // namespace palpate::view
