#include "palpate/scenes/apps/view/sampled.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <tbb/parallel_for.h>
#include <vtkFloatArray.h>
#include <vtkPointData.h>

namespace palpate::view {
namespace {

vtkSmartPointer<vtkImageData> lattice(const Box& box, int most, int border) {
  const double step = std::max(box.size().maxCoeff() / (most - 1), 1e-9);
  auto image = vtkSmartPointer<vtkImageData>::New();
  int size[3];
  for (int a = 0; a < 3; ++a) {
    size[a] =
        std::clamp(static_cast<int>(std::ceil(box.size()[a] / step)) + 1, 2, most + 1) + 2 * border;
  }
  image->SetDimensions(size);
  image->SetSpacing(step, step, step);
  const Vec3 origin = box.lower - Vec3::Constant(border * step);
  image->SetOrigin(origin.x(), origin.y(), origin.z());
  return image;
}

vtkSmartPointer<vtkFloatArray> array(const char* name, int components, vtkIdType count) {
  auto values = vtkSmartPointer<vtkFloatArray>::New();
  values->SetName(name);
  values->SetNumberOfComponents(components);
  values->SetNumberOfTuples(count);
  return values;
}

/// Calls `put(index, p, cache)` for each point p of the lattice [m], in parallel.
template <class F, class Put>
void readAll(const F& field, vtkImageData& image, const Put& put) {
  int size[3];
  image.GetDimensions(size);
  const Vec3 origin(image.GetOrigin());
  const double step = image.GetSpacing()[0];
  tbb::parallel_for(0, size[2], [&](int k) {
    FieldCache cache;
    field.reset(cache);
    vtkIdType index = static_cast<vtkIdType>(k) * size[0] * size[1];
    for (int j = 0; j < size[1]; ++j) {
      for (int i = 0; i < size[0]; ++i, ++index) {
        put(index, origin + step * Vec3(i, j, k), cache);
      }
    }
  });
}

}  // namespace

vtkSmartPointer<vtkImageData> sampled(const ScalarField& field, int most, int border) {
  auto image = lattice(field.frame().bounds, most, border);
  auto values = array("value", 1, image->GetNumberOfPoints());
  float* out = values->GetPointer(0);
  readAll(field, *image, [&](vtkIdType index, const Vec3& p, FieldCache& cache) {
    const double value = field.sample(p, cache).value;
    out[index] = std::isfinite(value) ? static_cast<float>(value) : 0.0F;
  });
  image->GetPointData()->SetScalars(values);
  return image;
}

vtkSmartPointer<vtkImageData> sampled(const VectorField& field, Along along, int most) {
  auto image = lattice(field.frame().bounds, most, 0);
  auto vectors = array("vector", 3, image->GetNumberOfPoints());
  auto values = array("value", 1, image->GetNumberOfPoints());
  float* out = vectors->GetPointer(0);
  float* sizes = values->GetPointer(0);
  readAll(field, *image, [&](vtkIdType index, const Vec3& p, FieldCache& cache) {
    const Vec3 v = vectorAt(field, along, p, cache);
    for (int a = 0; a < 3; ++a) out[3 * index + a] = static_cast<float>(v[a]);
    sizes[index] = static_cast<float>(v.norm());
  });
  image->GetPointData()->SetVectors(vectors);
  image->GetPointData()->SetScalars(values);
  return image;
}

std::pair<double, double> usual(vtkImageData& image) {
  auto* values = static_cast<float*>(image.GetScalarPointer());
  const vtkIdType count = image.GetNumberOfPoints();
  std::vector<float> some;
  for (vtkIdType i = 0; i < count; i += std::max<vtkIdType>(1, count / 50000)) {
    some.push_back(values[i]);
  }
  std::sort(some.begin(), some.end());
  const float low = some[some.size() / 50];
  const float high = some[some.size() - 1 - some.size() / 200];
  return {low, high > low ? high : low + 1.0F};
}

}  // namespace palpate::view
