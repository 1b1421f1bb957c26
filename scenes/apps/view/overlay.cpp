#include "palpate/scenes/apps/view/overlay.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Geometry>
#include <vtkArrowSource.h>
#include <vtkCylinderSource.h>
#include <vtkDiskSource.h>
#include <vtkMatrix4x4.h>
#include <vtkPolyDataMapper.h>
#include <vtkProperty.h>
#include <vtkSphereSource.h>

namespace palpate::view {
namespace {

Vec3 vectorOf(const std::array<double, 3>& a) {
  return {a[0], a[1], a[2]};
}

/// Shows an actor at a position. Its axis `axis` (0 to 2) gets the direction `along` and the length
/// `length`; the other axes get the width.
void put(vtkActor& actor, int axis, const Vec3& at, const Vec3& along, double length,
         double width) {
  Vec3 axes[3];
  axes[axis] = along.norm() > 1e-12 ? Vec3(along.normalized()) : Vec3::UnitX();
  const Vec3 aside = std::abs(axes[axis].x()) < 0.9 ? Vec3::UnitX() : Vec3::UnitY();
  axes[(axis + 1) % 3] = axes[axis].cross(aside).normalized();
  axes[(axis + 2) % 3] = axes[axis].cross(axes[(axis + 1) % 3]);
  auto matrix = vtkSmartPointer<vtkMatrix4x4>::New();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      matrix->SetElement(i, j, axes[j][i] * (j == axis ? length : width));
    }
    matrix->SetElement(i, 3, at[i]);
  }
  actor.SetUserMatrix(matrix);
  actor.VisibilityOn();
}

vtkSmartPointer<vtkCylinderSource> cylinder() {
  auto source = vtkSmartPointer<vtkCylinderSource>::New();
  source->SetResolution(10);
  source->SetRadius(0.5);
  source->SetHeight(1.0);
  return source;
}

vtkSmartPointer<vtkSphereSource> ball() {
  auto source = vtkSmartPointer<vtkSphereSource>::New();
  source->SetRadius(0.5);
  source->SetThetaResolution(16);
  source->SetPhiResolution(12);
  return source;
}

}  // namespace

Colour colourOf(cli::Hold hold) {
  switch (hold) {
    case cli::Hold::kHolds:
      return kHolds;
    case cli::Hold::kYields:
      return kYields;
    case cli::Hold::kPushes:
      return kPushes;
    case cli::Hold::kIdle:
      break;
  }
  return kIdle;
}

cli::Load loadIn(const LiveTick& tick, const LivePrimitive& primitive) {
  StepReport report;
  report.proxy = vectorOf(tick.proxy);
  report.stiffness = tick.stiffness;
  report.error_bound = tick.error_bound;
  report.status = tick.status;
  cli::Load load = cli::loadOf({primitive.kind, vectorOf(primitive.position),
                                vectorOf(primitive.direction), primitive.strength},
                               vectorOf(primitive.force), report);
  load.friction = primitive.friction;
  return load;
}

Overlay::Overlay(vtkRenderer& renderer, double size, double opacity)
    : renderer_(renderer), size_(size), opacity_(opacity) {
  probe_ = add(ball()->GetOutputPort(), kProbe);
  proxy_ = add(ball()->GetOutputPort(), kProxy);
  spring_ = add(cylinder()->GetOutputPort(), {0.95, 0.95, 0.95});
  auto arrow = vtkSmartPointer<vtkArrowSource>::New();
  arrow->SetShaftResolution(10);
  arrow->SetTipResolution(16);
  force_ = add(arrow->GetOutputPort(), kForce);
  auto disc = vtkSmartPointer<vtkDiskSource>::New();
  disc->SetInnerRadius(0.42);
  disc->SetOuterRadius(0.5);
  disc->SetCircumferentialResolution(40);
  for (auto& primitive : primitives_) {
    primitive[static_cast<std::size_t>(PrimitiveKind::kForce)] =
        add(arrow->GetOutputPort(), kPushes);
    primitive[static_cast<std::size_t>(PrimitiveKind::kPoint)] =
        add(ball()->GetOutputPort(), kHolds);
    primitive[static_cast<std::size_t>(PrimitiveKind::kLine)] =
        add(cylinder()->GetOutputPort(), kHolds);
    primitive[static_cast<std::size_t>(PrimitiveKind::kPlane)] = add(disc->GetOutputPort(), kHolds);
  }
}

vtkSmartPointer<vtkActor> Overlay::add(vtkAlgorithmOutput* output, const Colour& colour) {
  auto mapper = vtkSmartPointer<vtkPolyDataMapper>::New();
  mapper->SetInputConnection(output);
  auto actor = vtkSmartPointer<vtkActor>::New();
  actor->SetMapper(mapper);
  vtkProperty* look = actor->GetProperty();
  look->SetColor(colour[0], colour[1], colour[2]);
  look->SetOpacity(opacity_);
  look->SetAmbient(0.4);
  look->SetDiffuse(0.7);
  actor->VisibilityOff();
  renderer_.AddActor(actor);
  all_.push_back(actor);
  return actor;
}

std::vector<std::array<double, 6>> Overlay::seen() const {
  std::vector<std::array<double, 6>> boxes;
  for (const auto& actor : all_) {
    if (actor->GetVisibility() == 0) continue;
    std::copy_n(actor->GetBounds(), 6, boxes.emplace_back().begin());
  }
  return boxes;
}

double Overlay::putArrow(vtkActor& actor, const Vec3& from, const Vec3& along, double least_width) {
  // The width of an arrow is ten times the radius of its head. The head is narrower than a ring.
  const double width = std::clamp(along.norm(), least_width, 0.4 * size_);
  put(actor, 0, from, along, along.norm(), width);
  return 0.1 * width;
}

void Overlay::show(const LiveTick& tick, const Fit& fit) {
  const Vec3 probe = vectorOf(tick.probe);
  const Vec3 proxy = vectorOf(tick.proxy);
  const Vec3 force = vectorOf(tick.force);
  // Axis along which each shape extends.
  constexpr int kArrow = 0;
  constexpr int kCylinder = 1;
  constexpr int kDisc = 2;
  const double ball_size = 0.028 * size_;
  put(*probe_, kArrow, probe, Vec3::UnitX(), ball_size, ball_size);
  put(*proxy_, kArrow, proxy, Vec3::UnitX(), ball_size, ball_size);
  spring_->VisibilityOff();
  const Vec3 apart = probe - proxy;
  if (apart.norm() > 0.2 * ball_size) {
    put(*spring_, kCylinder, 0.5 * (probe + proxy), apart, apart.norm(), 0.25 * ball_size);
  }
  force_->VisibilityOff();
  const Vec3 arrow = force * metresPerNewton();
  const double share = fit(proxy, proxy + arrow);
  force_shortened_ = share < 1.0;
  others_shortened_ = false;
  head_radius_ = 0.0;
  tip_ = proxy + share * arrow;

  for (auto& primitive : primitives_) {
    for (auto& actor : primitive) actor->VisibilityOff();
  }
  const std::size_t count = std::min<std::size_t>(tick.primitive_count, kMost);
  for (std::size_t i = 0; i < count; ++i) {
    const LivePrimitive& primitive = tick.primitives[i];
    const cli::Load load = loadIn(tick, primitive);
    // A mode that the user has switched off has a very small strength, and is not drawn.
    if (primitive.friction || primitive.strength < 1e-6) continue;
    vtkActor& actor = *primitives_[i][static_cast<std::size_t>(primitive.kind)];
    const Colour colour = colourOf(load.hold);
    actor.GetProperty()->SetColor(colour[0], colour[1], colour[2]);
    const Vec3& along = load.primitive.direction;
    const Vec3 from = proxy - load.primitive.position;
    switch (primitive.kind) {
      case PrimitiveKind::kForce: {
        const Vec3 reach = primitive.strength * metresPerNewton() * along;
        const double its_share = fit(proxy, proxy + reach);
        others_shortened_ = others_shortened_ || its_share < 1.0;
        (void)putArrow(actor, proxy, its_share * reach, 0.08 * size_);
        break;
      }
      case PrimitiveKind::kPoint:
        put(actor, kArrow, load.primitive.position, along, 0.6 * ball_size, 0.6 * ball_size);
        break;
      case PrimitiveKind::kLine:
        // Draws only the parts of lines and planes that are near the proxy.
        put(actor, kCylinder, load.primitive.position + along.dot(from) * along, along,
            0.16 * size_, 0.2 * ball_size);
        break;
      case PrimitiveKind::kPlane:
        put(actor, kDisc, proxy - along.dot(from) * along, along, 0.12 * size_, 0.12 * size_);
        break;
    }
  }
  if (arrow.norm() > 0.1 * ball_size) {
    head_radius_ = putArrow(*force_, proxy, tip_ - proxy, 0.12 * size_);
  }
}

}  // namespace palpate::view
