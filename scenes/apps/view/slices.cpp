#include "palpate/scenes/apps/view/slices.h"

#include <algorithm>
#include <cmath>

#include <vtkMatrix4x4.h>
#include <vtkPolyDataMapper.h>
#include <vtkProperty.h>
#include <vtkTexture.h>

namespace palpate::view {
namespace {

constexpr int kSide = 160;  ///< Number of points along each side of a slice.

}  // namespace

Slices::Slices(vtkRenderer& renderer) {
  for (Slice& slice : slices_) {
    slice.plane = vtkSmartPointer<vtkPlaneSource>::New();
    slice.image = vtkSmartPointer<vtkImageData>::New();
    slice.image->SetDimensions(kSide, kSide, 1);
    slice.image->AllocateScalars(VTK_UNSIGNED_CHAR, 3);
    auto texture = vtkSmartPointer<vtkTexture>::New();
    texture->SetInputData(slice.image);
    texture->InterpolateOn();
    auto mapper = vtkSmartPointer<vtkPolyDataMapper>::New();
    mapper->SetInputConnection(slice.plane->GetOutputPort());
    slice.actor = vtkSmartPointer<vtkActor>::New();
    slice.actor->SetMapper(mapper);
    slice.actor->SetTexture(texture);
    slice.actor->GetProperty()->LightingOff();
    slice.actor->VisibilityOff();
    renderer.AddActor(slice.actor);
  }
}

void Slices::show(const ScalarField& field, const Pose& pose, const Vec3& at, double low,
                  double high) {
  const Box& box = field.frame().bounds;
  const Vec3 place = pose.toRest(at).cwiseMax(box.lower).cwiseMin(box.upper);
  auto matrix = vtkSmartPointer<vtkMatrix4x4>::New();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) matrix->SetElement(i, j, pose.linear(i, j));
    matrix->SetElement(i, 3, pose.translate[i]);
  }
  FieldCache cache;
  field.reset(cache);
  for (int axis = 0; axis < 3; ++axis) {
    Slice& slice = slices_[static_cast<std::size_t>(axis)];
    const int u = (axis + 1) % 3;
    const int v = (axis + 2) % 3;
    Vec3 corner = box.lower;
    corner[axis] = place[axis];
    Vec3 across = Vec3::Zero();
    across[u] = box.size()[u];
    Vec3 up = Vec3::Zero();
    up[v] = box.size()[v];
    const Vec3 right = corner + across;
    const Vec3 top = corner + up;
    slice.plane->SetOrigin(corner.x(), corner.y(), corner.z());
    slice.plane->SetPoint1(right.x(), right.y(), right.z());
    slice.plane->SetPoint2(top.x(), top.y(), top.z());
    auto* out = static_cast<unsigned char*>(slice.image->GetScalarPointer());
    for (int j = 0; j < kSide; ++j) {
      for (int i = 0; i < kSide; ++i) {
        const Vec3 p = corner + (i + 0.5) / kSide * across + (j + 0.5) / kSide * up;
        const double value = field.sample(p, cache).value;
        const double share = std::clamp((value - low) / (high - low), 0.0, 1.0);
        const auto grey = static_cast<unsigned char>(std::isfinite(value) ? 255.0 * share : 0.0);
        for (int c = 0; c < 3; ++c) *out++ = grey;
      }
    }
    slice.image->Modified();
    slice.actor->SetUserMatrix(matrix);
    slice.actor->VisibilityOn();
  }
}

void Slices::hide() {
  for (const Slice& slice : slices_) slice.actor->VisibilityOff();
}

}  // namespace palpate::view
