#include "palpate/scenes/apps/view/felt_part.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <vtkClipPolyData.h>
#include <vtkFloatArray.h>
#include <vtkPointData.h>

namespace palpate::view {
namespace {

/// Returns a vertex after one Newton step towards the surface: the mesh is coarser than the data,
/// and a mask may end close to the surface.
Vec3 onSurface(const ScalarField& field, FieldCache& cache, double level, const Vec3& p) {
  const ScalarSample sample = field.sample(p, cache);
  const double slope = sample.gradient.squaredNorm();
  const FieldFrame& frame = field.frame();
  if (!sample.inside || !(slope > 0.0)) return p;
  const Vec3 step = (level - sample.value) / slope * frame.metres_per_unit * sample.gradient;
  // Ignores a longer step, which would lead to another part of the surface.
  constexpr double kVoxels = 8.0;
  return step.norm() < kVoxels * frame.voxel ? Vec3(p + step) : p;
}

}  // namespace

std::string textOf(const std::vector<Mask>& masks) {
  std::string text;
  for (const Mask& mask : masks) {
    text += fmt::format(" by {}", mask.field->id());
    for (const auto& [input, output] : mask.curve->knots()) {
      text += fmt::format(" {} {}", input, output);
    }
  }
  return text;
}

vtkSmartPointer<vtkPolyData> feltPart(vtkPolyData& surface, const ScalarField& field, double level,
                                      const std::vector<Mask>& masks) {
  auto kept = vtkSmartPointer<vtkPolyData>::New();
  kept->ShallowCopy(&surface);
  for (const Mask& mask : masks) {
    auto felt = vtkSmartPointer<vtkFloatArray>::New();
    felt->SetNumberOfTuples(kept->GetNumberOfPoints());
    tbb::parallel_for(tbb::blocked_range<vtkIdType>(0, kept->GetNumberOfPoints()),
                      [&](const tbb::blocked_range<vtkIdType>& points) {
                        FieldCache cache;
                        FieldCache cache_of_mask;
                        field.reset(cache);
                        mask.field->reset(cache_of_mask);
                        for (vtkIdType i = points.begin(); i != points.end(); ++i) {
                          Vec3 p;
                          kept->GetPoint(i, p.data());
                          const ScalarSample sample =
                              mask.field->sample(onSurface(field, cache, level, p), cache_of_mask);
                          const bool is_felt = sample.inside && (*mask.curve)(sample.value) > 0.0;
                          felt->SetValue(i, is_felt ? 1.0F : 0.0F);
                        }
                      });
    if (felt->GetNumberOfTuples() == 0 || felt->GetRange()[0] > 0.0) continue;
    kept->GetPointData()->SetScalars(felt);
    auto clip = vtkSmartPointer<vtkClipPolyData>::New();
    clip->SetInputData(kept);
    clip->SetValue(0.5);
    clip->Update();
    kept = vtkSmartPointer<vtkPolyData>::New();
    kept->ShallowCopy(clip->GetOutput());
    kept->GetPointData()->SetScalars(nullptr);
  }
  return kept;
}

}  // namespace palpate::view
