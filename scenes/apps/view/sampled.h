/// Samples fields on an even lattice, for VTK.
#pragma once

#include <utility>

#include <vtkImageData.h>
#include <vtkSmartPointer.h>

#include "palpate/engine/field/field.h"
#include "palpate/scenes/apps/view/streams.h"

namespace palpate::view {

/// Samples a scalar field over its bounds, at rest, with `most` points along the longest side. The
/// image is in W [m], its scalars are named "value". Slow, on all cores.
[[nodiscard]] vtkSmartPointer<vtkImageData> sampled(const ScalarField& field, int most);
/// Samples vectors, named "vector", zero where data are missing, and their magnitudes, named
/// "value".
[[nodiscard]] vtkSmartPointer<vtkImageData> sampled(const VectorField& field, Along along,
                                                    int most);
/// Returns the two values between which nearly all values lie.
[[nodiscard]] std::pair<double, double> usual(vtkImageData& image);

}  // namespace palpate::view
