/// Samples fields on a regular lattice, for drawing with VTK.
#pragma once

#include <utility>

#include <vtkImageData.h>
#include <vtkSmartPointer.h>

#include "palpate/engine/field/field.h"
#include "palpate/scenes/apps/view/streams.h"

namespace palpate::view {

/// Samples a scalar field in its rest pose, with about `most` points along the longest side of its
/// bounds, and `border` more points beyond each side. The image is in W [m]; its scalars have the
/// name "value". Slow; uses all cores.
[[nodiscard]] vtkSmartPointer<vtkImageData> sampled(const ScalarField& field, int most,
                                                    int border = 0);
/// Samples a vector field in the same way. The vectors have the name "vector" and are zero where
/// data are missing; their magnitudes have the name "value".
[[nodiscard]] vtkSmartPointer<vtkImageData> sampled(const VectorField& field, Along along,
                                                    int most);
/// Returns the 2nd and the 99.5th percentile of the values, or of every n-th value (50,000 to
/// 100,000 of them) if there are more. If these are equal, the second is the first plus 1.
[[nodiscard]] std::pair<double, double> usual(vtkImageData& image);

}  // namespace palpate::view
