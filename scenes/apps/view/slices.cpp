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
constexpr std::size_t kMostLines = 16;

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
                  double high, const std::vector<Shapes::Level>& levels, double time) {
  const Box& box = field.frame().bounds;
  const Vec3 place = pose.toRest(at).cwiseMax(box.lower).cwiseMin(box.upper);
  auto matrix = vtkSmartPointer<vtkMatrix4x4>::New();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) matrix->SetElement(i, j, pose.linear(i, j));
    matrix->SetElement(i, 3, pose.translate[i]);
  }
  FieldCache cache;
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
    // Samples a field at the slice's points, which `place_of` moves to the field's rest pose.
    const auto sample = [&](const ScalarField& of, const auto& place_of) {
      of.reset(cache);
      std::size_t next = 0;
      for (int j = 0; j < kSide; ++j) {
        for (int i = 0; i < kSide; ++i) {
          const Vec3 p = corner + (i + 0.5) / kSide * across + (j + 0.5) / kSide * up;
          values[next++] = of.sample(place_of(p), cache).value;
        }
      }
    };
    auto* out = static_cast<unsigned char*>(slice.image->GetScalarPointer());
    const auto paint = [&](std::size_t point, const Colour& colour) {
      for (std::size_t c = 0; c < 3; ++c) {
        out[3 * point + c] = static_cast<unsigned char>(255.0 * colour[c]);
      }
    };
    sample(field, [](const Vec3& p) { return p; });
    for (std::size_t point = 0; point < values.size(); ++point) {
      const double share = std::clamp((values[point] - low) / (high - low), 0.0, 1.0);
      Colour grey;
      grey.fill(std::isfinite(share) ? share : 0.0);
      paint(point, grey);
    }
    const auto draw = [&](const Shapes::Level& level) {
      for (std::size_t point = 0; point < values.size(); ++point) {
        if (crosses(values, point, level.value)) paint(point, level.colour);
      }
    };
    std::size_t drawn = 0;
    for (const Shapes::Level& level : levels) {
      if (level.field->id() != field.id() || drawn++ >= kMostLines) continue;
      draw(level);
    }
    for (const Shapes::Level& level : levels) {
      if (level.field->id() == field.id() || drawn++ >= kMostLines) continue;
      const Pose of_level = level.motion ? level.motion->poseAbout(at, time) : Pose{};
      sample(*level.field, [&](const Vec3& p) { return of_level.toRest(pose(p)); });
      draw(level);
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
