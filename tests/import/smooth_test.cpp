// Compares the importer's Gaussian with VTK's.
#include "palpate/scenes/apps/import/smooth.h"

#include <array>
#include <cmath>
#include <random>

#include <catch2/catch.hpp>
#include <vtkFloatArray.h>
#include <vtkImageData.h>
#include <vtkImageGaussianSmooth.h>
#include <vtkNew.h>
#include <vtkPointData.h>

#include "palpate/engine/error.h"

namespace palpate::smooth_test {
using namespace palpate::importer;

namespace {

Piece noise(int components, const Vec3& spacing) {
  std::mt19937 generator(7);
  std::uniform_real_distribution<float> uniform(-50.0F, 200.0F);
  Piece image;
  image.size = {23, 17, 11};
  image.file_from_index.linear = spacing.asDiagonal();
  const Values values(Type::kFloat32, components, std::size_t{23} * 17 * 11);
  for (std::size_t i = 0; i < values.size(); ++i) values.as<float>()[i] = uniform(generator);
  image.arrays.push_back({"a", values, "", "", false});
  return image;
}

/// Smooths with VTK.
vtkSmartPointer<vtkDataArray> byVtk(const Piece& image, double width) {
  const Values& values = image.arrays[0].values;
  vtkNew<vtkFloatArray> floats;
  floats->SetNumberOfComponents(values.components());
  floats->SetNumberOfTuples(static_cast<vtkIdType>(values.tuples()));
  std::copy_n(values.as<float>(), values.size(), floats->GetPointer(0));
  vtkNew<vtkImageData> data;
  data->SetDimensions(image.size.data());
  data->GetPointData()->SetScalars(floats);
  vtkNew<vtkImageGaussianSmooth> gauss;
  gauss->SetInputData(data);
  gauss->SetDimensionality(3);
  const Vec3 spacing = image.file_from_index.linear.diagonal();
  gauss->SetStandardDeviations(width / spacing[0], width / spacing[1], width / spacing[2]);
  gauss->SetRadiusFactors(3.0, 3.0, 3.0);
  gauss->Update();
  return gauss->GetOutput()->GetPointData()->GetScalars();
}

}  // namespace

TEST_CASE("the importer's Gaussian equals VTK's within 2e-4 also at edges and on short axes",
          "[smooth]") {
  const Vec3 spacing(1.0, 0.7, 2.5);
  for (const int components : {1, 3}) {
    for (const double width : {0.1, 0.4, 1.0, 3.0, 9.0}) {
      CAPTURE(components, width);
      Piece image = noise(components, spacing);
      const auto expected = byVtk(image, width);
      const Smoothed smoothed = smoothImage(image, image.arrays[0], {width, true}, "x");
      const Values& values = image.arrays[0].values;
      double worst = 0.0;
      for (std::size_t i = 0; i < values.tuples(); ++i) {
        for (int c = 0; c < components; ++c) {
          const double there = expected->GetComponent(static_cast<vtkIdType>(i), c);
          worst = std::max(worst, std::abs(values.at(i, c) - there));
        }
      }
      CHECK(worst < 2e-4);
      CHECK(smoothed.range > 0.0);
    }
  }
}

TEST_CASE("smoothing reports the rms change of the values and 0 for a constant image", "[smooth]") {
  Piece image = noise(1, Vec3::Ones());
  Piece flat = noise(1, Vec3::Ones());
  for (std::size_t i = 0; i < 4301; ++i) flat.arrays[0].values.as<float>()[i] = 3.0F;
  CHECK(smoothImage(flat, flat.arrays[0], {2.0, true}, "x").rms_change < 1e-6);
  const Values before = image.arrays[0].values;
  const Smoothed smoothed = smoothImage(image, image.arrays[0], {1.0, true}, "x");
  double squares = 0.0;
  for (std::size_t i = 0; i < before.tuples(); ++i) {
    squares += std::pow(image.arrays[0].values.at(i, 0) - before.at(i, 0), 2);
  }
  CHECK(smoothed.rms_change ==
        Approx(std::sqrt(squares / static_cast<double>(before.tuples()))).epsilon(1e-9));
}

TEST_CASE("the effect of a smoothing width in voxels does not depend on the size of the voxels",
          "[smooth]") {
  Piece stretched = noise(1, Vec3(1.0, 0.7, 2.5));
  Piece cubic = noise(1, Vec3::Ones());
  (void)smoothImage(stretched, stretched.arrays[0], {1.5, false}, "x");
  (void)smoothImage(cubic, cubic.arrays[0], {1.5, true}, "x");
  for (std::size_t i = 0; i < 4301; ++i) {
    REQUIRE(stretched.arrays[0].values.at(i, 0) == cubic.arrays[0].values.at(i, 0));
  }
}

TEST_CASE("smoothing with a very wide Gaussian flattens an image", "[smooth]") {
  Piece image = noise(1, Vec3::Ones());
  CHECK(smoothImage(image, image.arrays[0], {1e6, true}, "x").range < 1e-2);
}

TEST_CASE("smoothing refuses an image with missing values at any width", "[smooth]") {
  for (const double width : {0.1, 1.0, 1e6}) {
    Piece image = noise(1, Vec3::Ones());
    image.arrays[0].values.as<float>()[5] = std::nanf("");
    CHECK_THROWS_AS(smoothImage(image, image.arrays[0], {width, true}, "x"), VolumeError);
  }
}

}  // namespace palpate::smooth_test
