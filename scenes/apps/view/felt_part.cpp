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

void moveToData(vtkPolyData& mesh, const ScalarField& field) {
  const FieldFrame& frame = field.frame();
  // At this distance from the edge, a sample is inside.
  const Vec3 within = Vec3::Constant(0.01 * frame.voxel);
  const Vec3 lower = frame.bounds.lower + within;
  const Vec3 upper = frame.bounds.upper - within;
  for (vtkIdType i = 0; i < mesh.GetNumberOfPoints(); ++i) {
    Vec3 p;
    mesh.GetPoint(i, p.data());
    p = p.cwiseMax(lower).cwiseMin(upper);
    mesh.GetPoints()->SetPoint(i, p.data());
  }
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

vtkSmartPointer<vtkImageData> feltCloud(vtkImageData& values, vtkPiecewiseFunction& opacity,
                                        const std::vector<Mask>& masks) {
  constexpr double kMost = 65535.0;
  auto cloud = vtkSmartPointer<vtkImageData>::New();
  cloud->CopyStructure(&values);
  cloud->AllocateScalars(VTK_UNSIGNED_SHORT, 2);
  std::vector<double> table(65536);
  opacity.GetTable(0.0, kMost, static_cast<int>(table.size()), table.data());
  const auto* in = static_cast<unsigned short*>(values.GetScalarPointer());
  auto* out = static_cast<unsigned short*>(cloud->GetScalarPointer());
  tbb::parallel_for(tbb::blocked_range<vtkIdType>(0, values.GetNumberOfPoints()),
                    [&](const tbb::blocked_range<vtkIdType>& points) {
                      std::vector<FieldCache> caches(masks.size());
                      for (std::size_t m = 0; m < masks.size(); ++m) {
                        masks[m].field->reset(caches[m]);
                      }
                      for (vtkIdType i = points.begin(); i != points.end(); ++i) {
                        Vec3 p;
                        values.GetPoint(i, p.data());
                        double share = table[in[i]];
                        for (std::size_t m = 0; m < masks.size() && share > 0.0; ++m) {
                          const ScalarSample sample = masks[m].field->sample(p, caches[m]);
                          const TransferFunction& curve = *masks[m].curve;
                          const double most = curve.highest();
                          const bool acts = sample.inside && most > 0.0;
                          share *= acts ? curve(sample.value) / most : 0.0;
                        }
                        out[2 * i] = in[i];
                        out[2 * i + 1] = static_cast<unsigned short>(kMost * share);
                      }
                    });
  return cloud;
}

}  // namespace palpate::view
