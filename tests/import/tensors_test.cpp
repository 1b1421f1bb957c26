// Tests direction, anisotropy and diffusivity for tensors with known eigenvalues.
#include "palpate/scenes/apps/import/tensors.h"

#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <random>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "palpate/scenes/apps/import/values.h"

namespace palpate::tensors_test {
using namespace palpate::importer;

namespace {

std::mt19937 generator(1729);

Mat3 randomRotation() {
  std::normal_distribution<double> normal;
  Eigen::Quaterniond q(normal(generator), normal(generator), normal(generator), normal(generator));
  return q.normalized().toRotationMatrix();
}

Mat3 tensor(const Mat3& axes, const Vec3& values) {
  return axes * values.asDiagonal() * axes.transpose();
}

/// Returns a tuple repeated `count` times.
template <class T, std::size_t N>
Values repeated(Type type, const std::array<double, N>& tuple, std::size_t count) {
  Values values(type, static_cast<int>(N), count);
  for (std::size_t i = 0; i < values.size(); ++i) values.as<T>()[i] = static_cast<T>(tuple[i % N]);
  return values;
}

/// Returns the elements of a matrix row by row.
std::array<double, 9> nineOf(const Mat3& D) {
  return {D(0, 0), D(0, 1), D(0, 2), D(1, 0), D(1, 1), D(1, 2), D(2, 0), D(2, 1), D(2, 2)};
}

/// Returns the fractional anisotropy of eigenvalues l (Basser and Pierpaoli).
double anisotropy(const Vec3& l) {
  return std::sqrt(1.5) * (l - Vec3::Constant(l.mean())).norm() / l.norm();
}

}  // namespace

TEST_CASE("the direction of a tensor is the eigenvector of its greatest eigenvalue in any frame",
          "[tensor]") {
  std::uniform_real_distribution<double> uniform(0.0, 1.0);
  for (int n = 0; n < 2000; ++n) {
    const Mat3 axes = randomRotation();
    const Vec3 values(1.2 + uniform(generator), uniform(generator), uniform(generator));
    const double scale = std::pow(10.0, -12.0 + 15.0 * uniform(generator));
    CAPTURE(n, values.transpose(), scale);
    const Diffusion felt = diffusionOf(scale * tensor(axes, values));
    CHECK(felt.direction.norm() == Approx(1.0));
    CHECK(std::abs(felt.direction.dot(axes.col(0))) == Approx(1.0).epsilon(1e-9));
    CHECK(felt.anisotropy == Approx(anisotropy(values)).epsilon(1e-9));
    CHECK(felt.diffusivity == Approx(scale * values.mean()).epsilon(1e-9));
  }
}

TEST_CASE("the first nonzero component of a tensor's direction is positive", "[tensor]") {
  for (int n = 0; n < 200; ++n) {
    const Mat3 axes = randomRotation();
    CHECK(diffusionOf(tensor(axes, {3, 1, 1})).direction.x() > 0.0);
  }
  CHECK(diffusionOf(Vec3(1, 2, 3).asDiagonal()).direction.isApprox(Vec3::UnitZ()));
  CHECK(diffusionOf(Vec3(1, 3, 2).asDiagonal()).direction.isApprox(Vec3::UnitY()));
  const Vec3 n = Vec3(0, -1, 1).normalized();
  CHECK(diffusionOf(n * n.transpose()).direction.isApprox(-n));
}

TEST_CASE("the fractional anisotropy grows from 0 for a spherical tensor to 1 for a linear tensor",
          "[tensor]") {
  const Mat3 axes = randomRotation();
  CHECK(diffusionOf(tensor(axes, {1, 1, 1})).anisotropy == Approx(0.0).margin(1e-12));
  CHECK(diffusionOf(tensor(axes, {1, 0, 0})).anisotropy == Approx(1.0));
  CHECK(diffusionOf(tensor(axes, {1, 1, 0})).anisotropy == Approx(std::sqrt(0.5)));
  CHECK(diffusionOf(tensor(axes, {1.7, 0.3, 0.3})).anisotropy == Approx(0.7990).epsilon(1e-3));
}

TEST_CASE("the direction of an isotropic tensor or of a zero tensor is zero", "[tensor]") {
  CHECK(diffusionOf(tensor(randomRotation(), {2, 2, 2})).direction.isZero());
  CHECK(diffusionOf(Mat3::Zero()).direction.isZero());
  CHECK(diffusionOf(-Mat3::Identity()).direction.isZero());
}

TEST_CASE("negative eigenvalues count as 0 in the anisotropy but not in the mean diffusivity",
          "[tensor]") {
  const Diffusion felt = diffusionOf(tensor(randomRotation(), {2, 1, -0.5}));
  CHECK(felt.anisotropy == Approx(anisotropy({2, 1, 0})));
  CHECK(felt.diffusivity == Approx(2.5 / 3.0));
}

TEST_CASE("all quantities derived from a tensor with a value that is not finite are zero",
          "[tensor]") {
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    Mat3 D = Mat3::Identity();
    D(1, 2) = bad;
    const Diffusion felt = diffusionOf(D);
    CHECK(felt.direction.isZero());
    CHECK(felt.anisotropy == 0.0);
    CHECK(felt.diffusivity == 0.0);
  }
}

TEST_CASE("tensors of six integers and of nine doubles give equal results", "[tensor]") {
  const Mat3 D = (Mat3() << 4, 1, 2, 1, 5, 3, 2, 3, 6).finished();
  const Diffusion expected = diffusionOf(D);
  const std::array<double, 6> xx_yy_zz_xy_yz_xz{4, 5, 6, 1, 3, 2};
  for (const Values& tensors : {repeated<std::int16_t>(Type::kInt16, xx_yy_zz_xy_yz_xz, 5000),
                                repeated<double>(Type::kFloat64, nineOf(D), 5000)}) {
    const auto felt = diffusionOf(Array{"t", tensors, "", "", false});
    CHECK(felt[0].name == "t_direction");
    CHECK(felt[1].name == "t_anisotropy");
    CHECK(felt[2].name == "t_diffusivity");
    for (const std::size_t i : {0, 4999}) {
      for (int c = 0; c < 3; ++c) {
        CHECK(felt[0].values.at(i, c) == Approx(expected.direction[c]));
      }
      CHECK(felt[1].values.at(i, 0) == Approx(expected.anisotropy));
      CHECK(felt[2].values.at(i, 0) == Approx(5.0));
    }
  }
}

TEST_CASE("a rotation of the space rotates tensors of six and of nine components", "[tensor]") {
  for (int n = 0; n < 100; ++n) {
    const Mat3 axes = randomRotation();
    const Mat3 R = randomRotation();
    const Mat3 D = tensor(axes, {3, 2, 1});
    const std::array<double, 6> values{D(0, 0), D(1, 1), D(2, 2), D(0, 1), D(1, 2), D(0, 2)};
    const Values six = repeated<double>(Type::kFloat64, values, 1);
    const Values nine = repeated<double>(Type::kFloat64, nineOf(D), 1);
    const Mat3 expected = tensor(R * axes, {3, 2, 1});
    const Values a = turned(six, R);
    const Values b = turned(nine, R);
    CHECK(tensorOf(a.as<double>(), 6).isApprox(expected, 1e-12));
    CHECK(tensorOf(b.as<double>(), 9).isApprox(expected, 1e-12));
  }
}

TEST_CASE("values are rescaled only if slope and offset are valid and have an effect", "[values]") {
  const Values values = repeated<std::int16_t>(Type::kInt16, std::array{7.0}, 1);
  CHECK(rescaled(values, 0.0, 5.0).data() == values.data());
  CHECK(rescaled(values, 1.0, 0.0).data() == values.data());
  CHECK(rescaled(values, std::nan(""), 0.0).data() == values.data());
  CHECK(rescaled(values, 2.0, 1.0).at(0, 0) == 15.0);
}

}  // namespace palpate::tensors_test
