/// What readers do to arrays: scaling, and turning vectors and tensors with their space.
#pragma once

#include <cstddef>
#include <vector>

#include <vtkDataArray.h>
#include <vtkSmartPointer.h>

#include "palpate/engine/types.h"

namespace palpate::importer {

/// Where xx yy zz xy yz xz, VTK's order of six, are in the upper triangle row by row: xx xy xz yy
/// yz zz; and in the lower one: xx yx yy zx zy zz.
inline const std::vector<int> kUpperTriangle{0, 3, 5, 1, 4, 2};
inline const std::vector<int> kLowerTriangle{0, 2, 5, 1, 4, 3};

/// slope * value + offset, as floats; the array itself where that changes nothing. A slope that is
/// 0 or not finite is NIfTI's and MetaImage's way to say that there is none.
[[nodiscard]] vtkSmartPointer<vtkDataArray> rescaled(vtkDataArray* values, double slope,
                                                     double offset);

/// Component c of the result is component order[c] of `values`, of the same type.
[[nodiscard]] vtkSmartPointer<vtkDataArray> picked(vtkDataArray* values,
                                                   const std::vector<int>& order);

/// Vectors M v, or tensors M D M^T (9 components row by row, or 6 in VTK's order). Floats and
/// doubles are changed in place, others become floats; the array itself for the identity.
[[nodiscard]] vtkSmartPointer<vtkDataArray> turned(vtkDataArray* values, const Mat3& M);

/// As above, of one tensor.
[[nodiscard]] Mat3 tensorOf(const double* six_or_nine, int components);

}  // namespace palpate::importer
