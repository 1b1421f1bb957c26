#include "palpate/scenes/apps/import/tensors.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

namespace palpate::importer {
namespace {

template <class T>
void fill(const T* data, const Values& tensors, float* direction, float* anisotropy,
          float* diffusivity) {
  const auto width = static_cast<std::size_t>(tensors.components());
  tbb::parallel_for(tbb::blocked_range<std::size_t>(0, tensors.tuples(), 1024),
                    [&](const tbb::blocked_range<std::size_t>& part) {
                      for (std::size_t i = part.begin(); i < part.end(); ++i) {
                        double numbers[9] = {};
                        for (std::size_t c = 0; c < width; ++c)
                          numbers[c] = static_cast<double>(data[i * width + c]);
                        const Diffusion one = diffusionOf(tensorOf(numbers, tensors.components()));
                        for (std::size_t c = 0; c < 3; ++c) {
                          direction[3 * i + c] =
                              static_cast<float>(one.direction[static_cast<Eigen::Index>(c)]);
                        }
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
  // Scales the tensor to about 1, because diffusivities near 1e-9 m^2/s would lose accuracy.
  const Mat3 S = (D + D.transpose()) / (2.0 * size);
  const Eigen::SelfAdjointEigenSolver<Mat3> solver(S);
  const Vec3& values = solver.eigenvalues();  // in ascending order
  out.diffusivity = D.trace() / 3.0;
  const Vec3 lambda = values.cwiseMax(0.0);
  const double norm = lambda.norm();
  if (norm > 0.0) {
    const Vec3 between(lambda[0] - lambda[1], lambda[1] - lambda[2], lambda[2] - lambda[0]);
    out.anisotropy = std::min(std::sqrt(0.5) * between.norm() / norm, 1.0);
  }
  // If all eigenvalues are equal, rounding errors determine the direction, so it stays zero.
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
  const std::size_t count = tensors.values.tuples();
  const Values direction(Type::kFloat32, 3, count);
  const Values anisotropy(Type::kFloat32, 1, count);
  const Values diffusivity(Type::kFloat32, 1, count);
  visit(tensors.values, [&](const auto* data) {
    fill(data, tensors.values, direction.as<float>(), anisotropy.as<float>(),
         diffusivity.as<float>());
  });
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
