#include "palpate/scenes/apps/view/slices.h"

#include <algorithm>
#include <cmath>
#include <iterator>

#include <vtkMatrix4x4.h>
#include <vtkPolyDataMapper.h>
#include <vtkProperty.h>
#include <vtkTexture.h>

namespace palpate::view {
namespace {

constexpr int kSide = 160;  ///< Number of points along each side of a slice.

/// Returns true if the value `level` lies between a point of a slice and the next point to the
/// right or above.
bool crosses(const std::vector<double>& values, std::size_t point, double level) {
  constexpr std::size_t kRow = kSide;
  const bool above = values[point] > level;
  const bool right = (point + 1) % kRow != 0 && (values[point + 1] > level) != above;
  return right || (point + kRow < values.size() && (values[point + kRow] > level) != above);
}

}  // namespace

Slices::Slices(vtkRenderer& renderer, const std::string& planes) {
  if (planes.size() == 1 && planes[0] >= 'x' && planes[0] <= 'z') only_ = planes[0] - 'x';
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
                  double high, const std::vector<Shapes::Level>& levels) {
  const Box& box = field.frame().bounds;
  const Vec3 place = pose.toRest(at).cwiseMax(box.lower).cwiseMin(box.upper);
  auto matrix = vtkSmartPointer<vtkMatrix4x4>::New();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) matrix->SetElement(i, j, pose.linear(i, j));
    matrix->SetElement(i, 3, pose.translate[i]);
  }
  FieldCache cache;
  field.reset(cache);
  std::vector<Shapes::Level> own;
  std::copy_if(levels.begin(), levels.end(), std::back_inserter(own),
               [&](const Shapes::Level& level) { return level.field == field.id(); });
  std::vector<double> values(static_cast<std::size_t>(kSide) * kSide);
  for (int axis = 0; axis < 3; ++axis) {
    if (only_ >= 0 && axis != only_) continue;
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
    std::size_t next = 0;
    for (int j = 0; j < kSide; ++j) {
      for (int i = 0; i < kSide; ++i) {
        const Vec3 p = corner + (i + 0.5) / kSide * across + (j + 0.5) / kSide * up;
        values[next++] = field.sample(p, cache).value;
      }
    }
    auto* out = static_cast<unsigned char*>(slice.image->GetScalarPointer());
    for (std::size_t at_point = 0; at_point < values.size(); ++at_point) {
      const double value = values[at_point];
      const double share = std::clamp((value - low) / (high - low), 0.0, 1.0);
      Colour colour;
      colour.fill(std::isfinite(value) ? share : 0.0);
      for (const Shapes::Level& level : own) {
        if (crosses(values, at_point, level.value)) colour = level.colour;
      }
      for (const double c : colour) *out++ = static_cast<unsigned char>(255.0 * c);
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
