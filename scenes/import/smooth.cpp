#include "palpate/scenes/import/smooth.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>
#include <vtkFloatArray.h>
#include <vtkImageCast.h>
#include <vtkImageData.h>
#include <vtkImageGaussianSmooth.h>
#include <vtkNew.h>
#include <vtkPointData.h>

#include "palpate/engine/error.h"
#include "palpate/scenes/import/vtk_run.h"

namespace palpate::importer {

Smoothed smoothImage(const Piece& image, Array& array, double width, const std::string& file) {
  // Floats, and then no other copy: an array may be all the memory that there is.
  vtkNew<vtkImageData> image_data;
  std::array<int, 3> size = image.size;
  image_data->SetDimensions(size.data());
  image_data->GetPointData()->SetScalars(array.values);
  {
    vtkNew<vtkImageCast> cast;
    cast->SetInputData(image_data);
    cast->SetOutputScalarTypeToFloat();
    run(cast, file);
    array.values = cast->GetOutput()->GetPointData()->GetScalars();
    image_data->GetPointData()->SetScalars(array.values);
  }
  const vtkSmartPointer<vtkDataArray> original = array.values;
  const auto* before = static_cast<const float*>(original->GetVoidPointer(0));
  const vtkIdType count = original->GetNumberOfValues();
  const auto bad = std::count_if(before, before + count, [](float v) { return !std::isfinite(v); });
  if (bad > 0 || image.hidden != nullptr) {
    throw VolumeError(
        file, fmt::format("{} has voxels without data, which smoothing would spread", array.name),
        "import it without --smooth");
  }

  const Vec3 spacing = image.file_from_index.linear.colwise().norm().transpose();
  vtkNew<vtkImageGaussianSmooth> gauss;
  gauss->SetInputData(image_data);
  gauss->SetDimensionality(3);
  gauss->SetStandardDeviations(width / spacing[0], width / spacing[1], width / spacing[2]);
  gauss->SetRadiusFactors(3.0, 3.0, 3.0);
  run(gauss, file);
  const auto* after = static_cast<const float*>(gauss->GetOutput()->GetScalarPointer());

  Smoothed out;
  double squares = 0.0;
  for (vtkIdType i = 0; i < count; ++i) {
    const double change = static_cast<double>(after[i]) - static_cast<double>(before[i]);
    squares += change * change;
  }
  out.rms_change = std::sqrt(squares / static_cast<double>(count));
  array.values = gauss->GetOutput()->GetPointData()->GetScalars();
  if (array.values->GetNumberOfComponents() == 1) {
    const auto [low, high] = std::minmax_element(after, after + count);
    out.range = static_cast<double>(*high) - static_cast<double>(*low);
  } else {
    out.range = array.values->GetMaxNorm();
  }
  return out;
}

}  // namespace palpate::importer
