#include "palpate/scenes/import/tensors.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <vtkFloatArray.h>
#include <vtkSetGet.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/import/values.h"

namespace palpate::importer {
namespace {

vtkSmartPointer<vtkFloatArray> floats(vtkIdType tuples, int components) {
  auto out = vtkSmartPointer<vtkFloatArray>::New();
  out->SetNumberOfComponents(components);
  out->SetNumberOfTuples(tuples);
  return out;
}

template <class T>
void fill(vtkDataArray* tensors, float* direction, float* anisotropy, float* diffusivity) {
  const T* data = static_cast<const T*>(tensors->GetVoidPointer(0));
  const int width = tensors->GetNumberOfComponents();
  tbb::parallel_for(tbb::blocked_range<vtkIdType>(0, tensors->GetNumberOfTuples(), 1024),
                    [&](const tbb::blocked_range<vtkIdType>& part) {
                      for (vtkIdType i = part.begin(); i < part.end(); ++i) {
                        double numbers[9] = {};
                        for (int c = 0; c < width; ++c)
                          numbers[c] = static_cast<double>(data[i * width + c]);
                        const Diffusion one = diffusionOf(tensorOf(numbers, width));
                        for (int c = 0; c < 3; ++c)
                          direction[3 * i + c] = static_cast<float>(one.direction[c]);
                        anisotropy[i] = static_cast<float>(one.anisotropy);
                        diffusivity[i] = static_cast<float>(one.diffusivity);
                      }
                    });
}

}  // namespace

Diffusion diffusionOf(const Mat3& D) {
  Diffusion out;
  const double size = D.cwiseAbs().maxCoeff();
  if (!D.allFinite() || !(size > 0.0)) return out;
  // Scaled, so that diffusivities in m^2/s, of 1e-9, are as good as any.
  const Mat3 S = (D + D.transpose()) / (2.0 * size);
  const Eigen::SelfAdjointEigenSolver<Mat3> solver(S);
  const Vec3& values = solver.eigenvalues();  // rising
  out.diffusivity = D.trace() / 3.0;
  const Vec3 lambda = values.cwiseMax(0.0);
  const double norm = lambda.norm();
  if (norm > 0.0) {
    const Vec3 between(lambda[0] - lambda[1], lambda[1] - lambda[2], lambda[2] - lambda[0]);
    out.anisotropy = std::min(std::sqrt(0.5) * between.norm() / norm, 1.0);
  }
  // A ball has no direction: what the solver gives there is rounding.
  constexpr double kSame = 1e-6;
  if (!(values[2] > 0.0) || values[2] - values[0] <= kSame * values[2]) return out;
  out.direction = solver.eigenvectors().col(2).normalized();
  for (int c = 0; c < 3; ++c) {
    constexpr double kZero = 1e-9;
    if (std::abs(out.direction[c]) <= kZero) continue;
    if (out.direction[c] < 0.0) out.direction = -out.direction;
    break;
  }
  return out;
}

std::array<Array, 3> diffusionOf(const Array& tensors) {
  const vtkIdType count = tensors.values->GetNumberOfTuples();
  const auto direction = floats(count, 3);
  const auto anisotropy = floats(count, 1);
  const auto diffusivity = floats(count, 1);
  switch (tensors.values->GetDataType()) {
    vtkTemplateMacro(fill<VTK_TT>(tensors.values, direction->GetPointer(0),
                                  anisotropy->GetPointer(0), diffusivity->GetPointer(0)));
    default:
      throw VolumeError(tensors.name, "its values are no numbers", "choose another with --field");
  }
  std::array<Array, 3> out;
  out[0].name = tensors.name + "_direction";
  out[0].values = direction;
  out[0].axial = true;
  out[1].name = tensors.name + "_anisotropy";
  out[1].values = anisotropy;
  out[2].name = tensors.name + "_diffusivity";
  out[2].values = diffusivity;
  out[2].unit = tensors.unit;
  return out;
}

}  // namespace palpate::importer
